"""Recordings into numbers and pictures: arrays in, arrays out; only ``figures`` needs matplotlib."""

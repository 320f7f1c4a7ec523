"""Recordings run again: verified, compared, published."""

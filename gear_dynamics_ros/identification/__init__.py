"""Fits parameters to target numbers or to a recording: values, errors, and what the data can't tell apart."""

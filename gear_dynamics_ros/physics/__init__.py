"""The model: what is compiled and what is computed once."""

"""The source paper: its printed numbers and claims as data, the runs they need, and what became of them."""

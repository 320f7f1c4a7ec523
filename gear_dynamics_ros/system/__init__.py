"""Processes, signals, threads and files: what any program needs."""

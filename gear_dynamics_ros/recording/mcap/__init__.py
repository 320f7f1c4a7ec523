"""MCAP files: records, index, writer."""

"""What a recording contains and what an analysis of it gives, as text and files."""

"""What is shown of an evaluation: figures for a paper, tables for a terminal."""

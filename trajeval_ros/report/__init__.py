"""Presentation of evaluations: figures, tables, and HTML pages."""

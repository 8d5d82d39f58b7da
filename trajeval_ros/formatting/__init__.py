"""Numbers, names and tables as text: terminal, Markdown, LaTeX, CSV and HTML."""

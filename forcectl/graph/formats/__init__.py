"""Writing a block diagram: SVG, PNG, PDF, DOT, Mermaid, HTML."""

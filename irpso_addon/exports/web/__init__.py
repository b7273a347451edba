"""Writes a card's result as a web page: tiles of maps and photographs, the model's shader, and the page's own files."""

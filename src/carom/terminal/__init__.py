"""Code that commands share: options, progress, and text, tables and JSON on the terminal."""

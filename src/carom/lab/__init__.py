"""The laboratory: tools that compare, search and explain runs, one folder each."""

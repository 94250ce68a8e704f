"""Bodies from data files and arrays: a file for each family of formats, the mapping of columns, and the checks."""

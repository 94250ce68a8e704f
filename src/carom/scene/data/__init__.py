"""Bodies from data files and arrays: a module for each family of formats, the mapping of columns, and the checks."""

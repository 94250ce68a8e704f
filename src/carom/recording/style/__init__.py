"""How things are drawn: lengths of arrows, widths of lines, shapes and colours."""

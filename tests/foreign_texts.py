"""Texts of others that do harm where they are taken for more than text."""

FOREIGN = (
    r"./$\nope$",
    "$",
    "$$a_1$",
    r"\$x",
    "_hidden",
    "<script>alert('x')</script> & co",
    "two\nlines\tand\x00more",
    "\x1b[31mred\x07",
    "\u202eback",
    "\udcff is no text",
    "| *a* | `b` | [c](d) | {e} | #f",
    "漢字 🚗",
    "%s {0} \\N{DASH}",
    "x" * 5000,
    " ",
)

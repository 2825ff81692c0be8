"""Mathematics as MathML, which browsers draw without a script or a font from the net.

Pages hold LaTeX as GitHub shows it: ``$...$`` within a line, and ``$$``, lines, ``$$`` as a
block. Code keeps its dollars.
"""

from __future__ import annotations

import re

from latex2mathml.converter import convert

_CODE = re.compile(
    r"^(?P<fence>`{3,}|~{3,})[^\n]*\n.*?^(?P=fence)$|(?P<ticks>`+)(?!`).+?(?<!`)(?P=ticks)(?!`)",
    re.DOTALL | re.MULTILINE,
)
_BLOCK = re.compile(r"^\$\$\n(.+?)\n\$\$$", re.DOTALL | re.MULTILINE)
_INLINE = re.compile(r"(?<![\\$\w])\$(?=[^\s$])([^$\n]+?)(?<=[^\s\\])\$(?![\w$])")


def with_mathml(page: str) -> str:
    """Replace LaTeX on a page of Markdown, outside code, by MathML."""
    parts, end = [], 0
    for code in _CODE.finditer(page):
        parts += [_converted(page[end : code.start()]), code[0]]
        end = code.end()
    return "".join([*parts, _converted(page[end:])])


def _converted(text: str) -> str:
    text = _BLOCK.sub(lambda found: f"\n<div {_mathml(found[1], 'block')}</div>\n", text)
    return _INLINE.sub(lambda found: f"<span {_mathml(found[1], 'inline')}</span>", text)


def _mathml(latex: str, display: str) -> str:
    made = convert(" ".join(latex.replace(r"\|", r"\Vert ").split()), display=display)
    return f'class="math">{made}'

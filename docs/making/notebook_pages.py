"""Pages of the site from notebooks, with the output that is saved in them."""

from __future__ import annotations

import json
import re
from base64 import b64decode
from collections.abc import Iterator
from pathlib import Path
from typing import Any


def pages(folder: Path, target: Path) -> dict[str, str]:
    """Write the pictures of all notebooks in a folder; return each page by its path on the site.

    Raises:
        ValueError: an output that has neither text nor a PNG.
    """
    (target / "notebooks").mkdir(exist_ok=True)
    return {
        f"notebooks/{path.stem}.md": "\n\n".join(_cells(path, target / "notebooks")) + "\n"
        for path in sorted(folder.glob("*.ipynb"))
    }


def code_cells(path: Path) -> list[str]:
    """Code of a notebook's cells, in their order."""
    cells = json.loads(path.read_text("utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def _cells(path: Path, pictures: Path) -> Iterator[str]:
    number = 0
    for cell in json.loads(path.read_text("utf-8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            text = source.replace("](../../docs/", "](../")  # as the page lies in docs/notebooks
            yield re.sub(r"\]\((\w+)\.ipynb\)", r"](\1.md)", text)
            continue
        yield f"```python\n{source}\n```"
        for output in cell["outputs"]:
            number += 1
            yield _output(output, pictures / f"{path.stem}-{number}.png")


def _output(output: dict[str, Any], picture: Path) -> str:
    content = output.get("data", {})
    if "image/png" in content:
        picture.write_bytes(b64decode("".join(content["image/png"])))
        return f"![{content['text/plain'][0]}]({picture.name})"
    text = "".join(output.get("text") or content.get("text/plain") or ())
    if not text:
        raise ValueError(f"{picture.stem}: an output with neither text nor a PNG: {list(content)}")
    return f"```text\n{text.rstrip()}\n```"

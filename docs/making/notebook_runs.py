"""Run notebooks and save what their cells show: ``python docs/making/notebook_runs.py``.

Cells are plain Python, so they run here one after the other as a kernel would run them. What they
print, their last expression and pyplot's figures are saved.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
import tempfile
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

NOTEBOOKS = Path(__file__).parents[2] / "examples" / "notebooks"


def run(path: Path) -> Iterator[list[dict[str, Any]]]:
    """Run a notebook's cells of code in the current folder; give the outputs of each."""
    names: dict[str, Any] = {"__name__": "__main__"}
    for number, cell in enumerate(_code(json.loads(path.read_text("utf-8")))):
        yield _run_cell("".join(cell["source"]), names, f"{path.name}, cell {number}")


def save(path: Path) -> None:
    """Run a notebook and save it with its outputs."""
    notebook = json.loads(path.read_text("utf-8"))
    for number, (cell, outputs) in enumerate(zip(_code(notebook), run(path), strict=True), start=1):
        cell |= {"outputs": outputs, "execution_count": number}
        for output in outputs:
            if output["output_type"] == "execute_result":
                output["execution_count"] = number
    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", "utf-8")


def _code(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def _run_cell(source: str, names: dict[str, Any], where: str) -> list[dict[str, Any]]:
    from matplotlib import pyplot

    pictures: list[dict[str, Any]] = []

    def show() -> None:
        content = io.BytesIO()
        pyplot.gcf().savefig(content, format="png", dpi=80)
        pyplot.close()
        picture = b64encode(content.getvalue()).decode()
        data = {"image/png": picture, "text/plain": ["<Figure>"]}
        pictures.append({"output_type": "display_data", "data": data, "metadata": {}})

    tree, printed, last = ast.parse(source, where), io.StringIO(), None
    expression = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(printed), mock.patch.object(pyplot, "show", show):
        exec(compile(tree, where, "exec"), names)
        if expression is not None:
            last = eval(compile(ast.Expression(expression.value), where, "eval"), names)
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        lines = printed.getvalue().splitlines(keepends=True)
        outputs.append({"output_type": "stream", "name": "stdout", "text": lines})
    if last is not None:
        data = {"text/plain": repr(last).splitlines(keepends=True)}
        outputs.append({"output_type": "execute_result", "data": data, "metadata": {}})
    return outputs + pictures


if __name__ == "__main__":
    os.environ.setdefault("MPLBACKEND", "agg")
    for notebook in sorted(NOTEBOOKS.glob("*.ipynb")):
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            save(notebook)
        print(notebook.name)

"""Pages of the API reference, made from the sources without importing them.

griffe reads the package's code and docstrings; one page shows the names at the root, and one each
package below it. A docstring's roles, such as ``:func:`name```, become links.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import griffe

PACKAGES = {
    "envs": "Environment, human model and worlds",
    "exact": "Exact values and posteriors",
    "agents": "HMIs, drivers and episodes",
    "demonstrations": "Demonstrations",
    "training": "Training",
    "experiments": "Experiments",
    "paper": "The paper's numbers",
    "reporting": "Reports",
}
"""Title of the page of each package that has one."""
INTERNAL = frozenset(
    f"hmi_marl.envs.{name}"
    for name in (
        "action_loops",
        "compiled_rules",
        "copies",
        "elementwise",
        "execution",
        "executions",
        "groups",
        "loops",
        "observation_values",
        "shown_teams",
        "step_result",
        "team_arrays",
        "team_step",
        "vector_outcome",
    )
)
"""Modules of envs between its parts, compiled or over arrays, that users have no need of."""
_ROLE = re.compile(r":(?:py:)?[a-z]+:`~?([\w.]+)`")
_MATHEMATICS = re.compile(r":math:`([^`]+)`")
_COLUMNS = 88
"""Longer signatures have a line for each parameter."""


class Reference:
    """API reference of a package."""

    def __init__(self, folder: Path, packages: dict[str, str] = PACKAGES) -> None:
        """Read the sources below a folder that holds the package hmi_marl.

        Args:
            folder: the repository.
            packages: the title of each package's page.
        """
        self._titles = packages
        self._root = griffe.load("hmi_marl", search_paths=[folder], allow_inspection=False)

    def pages(self) -> dict[str, str]:
        """Return the Markdown of every page by its path on the site."""
        rest = {f"api/{name}.md": self._package_page(name) for name in self._titles}
        return {"api/index.md": self._root_page(), **rest}

    @cached_property
    def _modules(self) -> dict[str, list[griffe.Object]]:
        """Modules on the page of each package: at most two levels below the root."""
        return {
            name: [self._root[name], *self._submodules(self._root[name])] for name in self._titles
        }

    @cached_property
    def _public(self) -> dict[str, griffe.Object]:
        """What each name at the root stands for."""
        homes = self._constant("_HOMES")
        found = {}
        for name in self._constant("__all__"):
            if name in homes:
                module = self._root[homes[name]]
                found[name] = module[name] if name in module.members else module
        return found

    @cached_property
    def _places(self) -> dict[str, str]:
        """Page and anchor of every object that is shown, by its full name."""
        places = {}
        for name, thing in self._public.items():
            if not thing.is_module:
                for shown in (thing, *_members(thing)):
                    places[shown.path] = f"index.md#{_anchor(shown)}"
            else:
                places.setdefault(f"hmi_marl.{name}", "")
        for package, modules in self._modules.items():
            for module in modules:
                for thing in (module, *_members(module)):
                    for shown in (thing, *(_members(thing) if thing.is_class else ())):
                        places.setdefault(shown.path, f"{package}.md#{_anchor(shown)}")
        return {path: place for path, place in places.items() if place}

    def _constant(self, name: str) -> Any:
        return ast.literal_eval(str(self._root[name].value))

    @staticmethod
    def _submodules(package: griffe.Object) -> list[griffe.Object]:
        modules = (module for module in package.modules.values() if module.path not in INTERNAL)
        return sorted(modules, key=lambda module: module.path)

    def _root_page(self) -> str:
        modules = [
            f"| [hmi_marl.{name}]({name}.md) | {title} |" for name, title in self._titles.items()
        ]
        parts = [
            "# API reference",
            "Made from the sources. The names on this page are imported from the root, as in\n"
            "`from hmi_marl import TeamConfig`; each is loaded when it is first used. The pages\n"
            "of the packages hold the modules at most two levels below the root.",
            "\n".join(["| package | contents |", "| --- | --- |", *modules]),
        ]
        for name, thing in self._public.items():
            if thing.is_module:
                target = self._places[thing.path]
                parts.append(f"## {name}\n\n{_first_line(thing)} See [{thing.path}]({target}).")
            else:
                parts += self._object(thing, 2)
        return "\n\n".join(self._linked(part, "index.md") for part in parts) + "\n"

    def _package_page(self, name: str) -> str:
        package, *modules = self._modules[name]
        parts = [f"# {self._titles[name]}", f"Package `hmi_marl.{name}`.", *self._text(package)]
        listed = [
            f"| [{module.name}](#{_anchor(module)}) | {_first_line(module)} |" for module in modules
        ]
        parts.append("\n".join(["| module | contents |", "| --- | --- |", *listed]))
        for member in _members(package):
            parts += self._object(member, 2)
        for module in modules:
            parts.append(_heading(2, module.path.removeprefix("hmi_marl."), module))
            parts += self._text(module)
            for member in _members(module):
                parts += self._object(member, 3)
            inner = [f"`{part.path}`" for part in self._submodules(module)]
            if inner:
                parts.append("Modules: " + ", ".join(inner) + ".")
        return "\n\n".join(self._linked(part, f"{name}.md") for part in parts) + "\n"

    @staticmethod
    def _linked(part: str, page: str) -> str:
        """Shorten links to the page itself."""
        return part.replace(f"]({page}#", "](#")

    def _object(self, thing: griffe.Object, level: int) -> Iterator[str]:
        """A heading, the signature and the docstring of an object, and of a class's members."""
        yield _heading(level, thing.name, thing)
        if thing.path != self._shown_at(thing):
            yield f"`{thing.path}`"
        yield f"```python\n{_signature(thing)}\n```"
        yield from self._text(thing)
        if not thing.is_class:
            return
        fields = [member for member in _members(thing) if member.is_attribute]
        if fields:
            yield "\n".join(self._field(field) for field in fields)
        for method in _members(thing):
            if method.is_function:
                yield _heading(level + 1, f"{thing.name}.{method.name}", method)
                yield f"```python\n{_signature(method)}\n```"
                yield from self._text(method)

    def _shown_at(self, thing: griffe.Object) -> str:
        return thing.path if thing.name not in self._public else f"hmi_marl.{thing.name}"

    def _field(self, field: griffe.Attribute) -> str:
        kind = f": {field.annotation}" if field.annotation is not None else ""
        default = "" if field.value is None else f" = {_short(str(field.value))}"
        text = " ".join("\n".join(self._text(field)).split())
        return f'- <span id="{_anchor(field)}"></span>`{field.name}{kind}{default}`: {text}'

    def _text(self, thing: griffe.Object) -> Iterator[str]:
        if thing.docstring is None:
            return
        if thing.docstring.value.startswith("# "):  # a page of its own
            yield f"{_first_line(thing)} See [The environment](../environment.md)."
            return
        for section in thing.docstring.parse("google", warnings=False):
            yield self._with_links(_section(section), thing)

    def _with_links(self, text: str, scope: griffe.Object) -> str:
        def link(found: re.Match[str]) -> str:
            path = self._resolve(found[1], scope)
            return f"[`{found[1]}`]({self._places[path]})" if path else f"`{found[1]}`"

        return _ROLE.sub(link, _MATHEMATICS.sub(r"$\1$", text))

    def _resolve(self, name: str, scope: griffe.Object | None) -> str:
        """Full name of what a docstring names, or nothing if no page shows it."""
        known = self._places
        while scope is not None:
            if f"{scope.path}.{name}" in known:
                return f"{scope.path}.{name}"
            scope = scope.parent
        ends = [path for path in known if path == name or path.endswith(f".{name}")]
        return ends[0] if len(ends) == 1 or name in ends else ""


def _members(thing: griffe.Object) -> list[Any]:
    """Public members that are defined here and documented, in the order of the code."""
    return [
        member
        for name, member in thing.members.items()
        if not name.startswith("_") and not member.is_alias and not member.is_module
        if member.docstring is not None
    ]


def _heading(level: int, text: str, thing: griffe.Object) -> str:
    return f"{'#' * level} {text} {{ #{_anchor(thing)} }}"


def _anchor(thing: griffe.Object) -> str:
    return thing.path.removeprefix("hmi_marl.").replace(".", "-").lower()


def _first_line(thing: griffe.Object) -> str:
    text = thing.docstring.value.strip() if thing.docstring else ""
    line = text.split("\n\n")[0].removeprefix("# ").replace("\n", " ")
    line = _ROLE.sub(r"`\1`", line).replace("|", "\\|")
    return line if line.endswith(".") else line + "."


def _short(value: str) -> str:
    line = " ".join(value.split())
    return line if len(line) <= 60 else line[:57] + "..."


def _signature(thing: Any) -> str:
    if thing.is_attribute:
        kind = f": {thing.annotation}" if thing.annotation is not None else ""
        return f"{thing.name}{kind}" + (
            "" if thing.value is None else f" = {_short(str(thing.value))}"
        )
    if thing.is_class and not thing.parameters:
        bases = ", ".join(str(base) for base in thing.bases)
        return f"class {thing.name}" + (f"({bases})" if bases else "")
    parameters = list(_parameters(thing))
    returns = getattr(thing, "returns", None)
    end = f") -> {returns}" if returns is not None and not thing.is_class else ")"
    start = ("class " if thing.is_class else "def ") + f"{thing.name}("
    line = start + ", ".join(parameters) + end
    if len(line) <= _COLUMNS:
        return line
    return start + "".join(f"\n    {parameter}," for parameter in parameters) + f"\n{end}"


def _parameters(thing: Any) -> Iterator[str]:
    kinds = griffe.ParameterKind
    before = None
    for parameter in thing.parameters:
        if parameter.name in ("self", "cls"):
            continue
        stars = {kinds.var_positional: "*", kinds.var_keyword: "**"}.get(parameter.kind, "")
        if parameter.kind is kinds.keyword_only and before not in (
            kinds.keyword_only,
            kinds.var_positional,
        ):
            yield "*"
        before = parameter.kind
        text = f"{stars}{parameter.name}"
        if parameter.annotation is not None:
            text += f": {parameter.annotation}"
        if parameter.default is not None and not stars:
            equals = " = " if parameter.annotation is not None else "="
            text += f"{equals}{_short(str(parameter.default))}"
        yield text


def _section(section: Any) -> str:
    """Markdown of a part of a docstring."""
    if section.kind is griffe.DocstringSectionKind.text:
        return _fenced(section.value)
    if section.kind is griffe.DocstringSectionKind.examples:
        return "\n\n".join(_fenced(text) for _, text in section.value)
    title = section.title or section.kind.value.capitalize()
    if section.kind is griffe.DocstringSectionKind.admonition:
        return f"**{title}:** {_fenced(section.value.description)}"
    rows = []
    for item in section.value:
        name = getattr(item, "name", "") or (str(item.annotation) if item.annotation else "")
        text = " ".join(item.description.split())
        rows.append(f"- `{name}`: {text}" if name else f"- {text}")
    return f"**{title}:**\n\n" + "\n".join(rows)


def _fenced(text: str) -> str:
    """Put doctests and indented blocks into fences."""
    parts = text.strip("\n").split("\n\n")
    return "\n\n".join(
        f"```pycon\n{part}\n```" if part.lstrip().startswith(">>>") else part for part in parts
    )

"""Draw docs/architecture.svg, the imports by folder, and write the table of docs/architecture.md."""

from __future__ import annotations

import ast
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

ROOT: Final = Path(__file__).resolve().parents[1]
PACKAGE: Final = "gear_dynamics_ros"
CONTRACT: Final = "contract"  # the modules beside the folders
PICTURE: Final = ROOT / "docs" / "architecture.svg"
PAGE: Final = ROOT / "docs" / "architecture.md"
BEGIN, END = "<!-- folders: written by scripts/architecture.py -->", "<!-- end of folders -->"
WIDTH, HEIGHT = 2.5, 0.9  # of a box, inches
GAP_X, GAP_Y = 0.34, 0.62


class Import(NamedTuple):
    """One import of one module of the package by another."""

    importer: str  # path of the file, relative to the package
    imported: str  # dotted name, the package's own name left out


def room_of(module: str) -> str:
    """Folder of a dotted module name, or of a file's path, relative to the package."""
    parts = module.removesuffix(".py").replace("/", ".").split(".")
    return parts[0] if (ROOT / PACKAGE / parts[0]).is_dir() else CONTRACT


def imports() -> Iterator[Import]:
    """Every import of the package by itself, those inside functions and for type checkers included."""
    source = ROOT / PACKAGE
    for path in sorted(source.rglob("*.py")):
        for name in imported_names(path):
            if name == PACKAGE or name.startswith(f"{PACKAGE}."):
                yield Import(path.relative_to(source).as_posix(), name[len(PACKAGE) + 1 :])


@cache
def imported_names(path: Path) -> tuple[str, ...]:
    """Dotted names that a file imports, in its order."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return tuple(name for node in nodes for name in _imported(node))


def edges() -> dict[tuple[str, str], int]:
    """Number of imports from folder to folder."""
    found: Counter[tuple[str, str]] = Counter()
    for importer, imported in imports():
        pair = room_of(importer), room_of(imported)
        if pair[0] != pair[1] and (imported and importer != "__init__.py"):
            found[pair] += 1
    return dict(sorted(found.items()))


def lines() -> dict[str, int]:
    """Lines of code by folder."""
    found: Counter[str] = Counter()
    source = ROOT / PACKAGE
    for path in source.rglob("*.py"):
        with path.open(encoding="utf-8") as file:
            found[room_of(path.relative_to(source).as_posix())] += sum(1 for _ in file)
    return dict(sorted(found.items()))


def floors(pairs: Mapping[tuple[str, str], int]) -> dict[str, int]:
    """Height of each folder, above all that it imports and right below the lowest that imports it.

    Raises ValueError on a circle.
    """
    users: dict[str, set[str]] = {}
    for importer, imported in pairs:
        users.setdefault(importer, set())
        users.setdefault(imported, set()).add(importer)
    depth: dict[str, int] = {}
    while len(depth) < len(users):
        ready = {room for room in users.keys() - depth.keys() if users[room] <= depth.keys()}
        if not ready:
            raise ValueError(f"these import each other in a circle: {sorted(users.keys() - depth.keys())}")
        depth |= {room: 1 + max((depth[above] for above in users[room]), default=-1) for room in ready}
    return {room: max(depth.values()) - found for room, found in depth.items()}


def direct(pairs: Mapping[tuple[str, str], int]) -> list[tuple[str, str]]:
    """The pairs that no way through other folders replaces: what the picture shows."""
    below: dict[str, set[str]] = {}

    def all_below(room: str) -> set[str]:
        if room not in below:
            uses = {imported for importer, imported in pairs if importer == room}
            below[room] = uses.union(*map(all_below, uses))
        return below[room]

    return [
        (importer, imported)
        for importer, imported in pairs
        if not any(imported in all_below(other) for who, other in pairs if who == importer)
    ]


def purpose(room: str) -> str:
    """First sentence of a folder's docstring."""
    if room == CONTRACT:
        return "Names, units and shapes that all folders share."
    text = (ROOT / PACKAGE / room / "__init__.py").read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(text)) or "").split("\n")[0].replace("``", "")


def places(pairs: Mapping[tuple[str, str], int]) -> dict[str, tuple[float, float]]:
    """Lower left corner of each folder's box in inches: in rows, each near those that import it."""
    height = floors(pairs)
    rows: dict[int, list[str]] = {}
    for room in sorted(height):
        rows.setdefault(height[room], []).append(room)
    width = max(map(len, rows.values())) * (WIDTH + GAP_X) + GAP_X
    found: dict[str, tuple[float, float]] = {}
    shown = direct(pairs)
    for floor in sorted(rows, reverse=True):

        def middle(room: str) -> float:
            above = [found[importer][0] for importer, imported in shown if imported == room]
            return sum(above) / len(above) if above else 0.0

        rooms = sorted(rows[floor], key=middle)
        begin = 0.5 * (width - len(rooms) * (WIDTH + GAP_X) + GAP_X)
        for place, room in enumerate(rooms):
            found[room] = begin + place * (WIDTH + GAP_X), GAP_Y + floor * (HEIGHT + GAP_Y)
    return found


def draw(pairs: Mapping[tuple[str, str], int]) -> Figure:
    """Folders as boxes, each above all that it imports; an arrow points to what is imported."""
    corner, sizes = places(pairs), lines()
    width = max(x for x, _ in corner.values()) + WIDTH + GAP_X
    height = max(y for _, y in corner.values()) + HEIGHT + GAP_Y
    figure = Figure(figsize=(width, height))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, width), ylim=(0.0, height))
    axes.axis("off")
    for room, (x, y) in corner.items():
        style = "round,pad=0,rounding_size=0.08"
        axes.add_patch(FancyBboxPatch((x, y), WIDTH, HEIGHT, boxstyle=style, fc="#EAF2F8", ec="#0072B2"))
        top = y + HEIGHT - 0.24
        axes.text(x + 0.12, top, room, fontsize=12, weight="bold", color="#1B2A34")
        axes.text(x + WIDTH - 0.12, top, f"{sizes[room]} lines", fontsize=8.5, ha="right", color="#555555")
        axes.text(x + 0.12, top - 0.09, _wrapped(purpose(room)), fontsize=8, va="top", color="#333333")
    for importer, imported in direct(pairs):
        _draw_arrow(axes, corner[importer], corner[imported])
    return figure


def _draw_arrow(axes: Axes, above: tuple[float, float], below: tuple[float, float]) -> None:
    """From the lower edge of the box at ``above`` to the upper edge of that at ``below``."""
    lean = 0.16 * WIDTH * max(-1.0, min(1.0, (below[0] - above[0]) / WIDTH))
    start = above[0] + 0.5 * WIDTH + lean, above[1]
    end = below[0] + 0.5 * WIDTH - lean, below[1] + HEIGHT
    axes.add_patch(
        FancyArrowPatch(
            start,
            end,
            arrowstyle="-|>",
            mutation_scale=11,
            lw=1.1,
            color="#7A4A1E",
            shrinkA=0,
            shrinkB=1,
            zorder=0.5,
        )
    )


def table(pairs: Mapping[tuple[str, str], int]) -> str:
    """The folders, from the top down, with what each imports and how often."""
    height, sizes = floors(pairs), lines()
    rows = ["| folder | lines | what it is | imports (times) |", "|---|---|---|---|"]
    for room in sorted(height, key=lambda room: (-height[room], room)):
        uses = [f"{imported} {count}" for (importer, imported), count in pairs.items() if importer == room]
        rows.append(f"| `{room}` | {sizes[room]} | {purpose(room)} | {', '.join(uses) or 'nothing'} |")
    summary = f"{len(height)} folders, {len(pairs)} pairs with {sum(pairs.values())} imports."
    return "\n".join([summary, "", *rows])


def page(text: str, pairs: Mapping[tuple[str, str], int]) -> str:
    """``text`` of the page with today's table between its marks. Raises ValueError where they are missing."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{PAGE} lacks the lines {BEGIN!r} and {END!r}")
    return f"{before}{begin}\n\n{table(pairs)}\n\n{end}{after}"


def main() -> int:
    """Write picture and table; returns the exit code."""
    pairs = edges()
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), pairs), encoding="utf-8")
    # Text as text, and no random names: a small file that changes only where the folders do.
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": PACKAGE}):
        draw(pairs).savefig(PICTURE, metadata={"Date": None})
    print(f"{PICTURE.relative_to(ROOT)}, {PAGE.relative_to(ROOT)}")
    return 0


def _imported(node: ast.AST) -> list[str]:
    """Dotted names that a statement imports: of ``from a import b`` both, as b may be a module of a."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.module and not node.level:
        folder = ROOT / Path(*node.module.split("."))
        modules = [alias.name for alias in node.names if _is_module(folder / alias.name)]
        others = len(modules) < len(node.names)
        return [f"{node.module}.{name}" for name in modules] + [node.module] * others
    return []


def _is_module(path: Path) -> bool:
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def _wrapped(text: str, limit: int = 39) -> str:
    shown: list[str] = [""]
    for word in text.split():
        if len(shown[-1]) + len(word) >= limit:
            shown.append("")
        shown[-1] = f"{shown[-1]} {word}".strip()
    return "\n".join(shown[:3])


if __name__ == "__main__":
    sys.exit(main())

"""The house keeps its shape: imports point down, files stay readable, and help answers without the heavy libraries."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LONGEST_FILE = 350
LAYERS = [
    {"core", "core.errors", "core.report", "core.words"},  # "core" itself: the version
    {"core.config", "core.ply_file"},
    {"core.system"},
    {"core.kernels"},
    {"core.scene"},
    {"core.appearance", "core.rasterizer", "core.data", "core.export"},
    {"core.training", "core.evaluation"},
    {"core.looks"},
    {"core.pipeline", "core.doctor"},
    {"core.bench"},
    {"wegs_cli"},
]
HEIGHT = {part: height for height, parts in enumerate(LAYERS) for part in parts}
SOURCES = sorted([*ROOT.glob("core/**/*.py"), *ROOT.glob("wegs_cli/**/*.py")])


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path) for path in SOURCES}


def part_of(module: str) -> str:
    """The member of LAYERS that a module belongs to: its first two names, or one for wegs_cli."""
    names = module.split(".")
    return ".".join(names[:2] if names[0] == "core" else names[:1])


def imports_of(path: Path, source: str) -> set[str]:
    """The modules of ours that a file imports anywhere, functions and type-checking blocks included."""
    module = module_of(path)
    package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            origin = ".".join([*above, *(node.module.split(".") if node.module else [])])
            for alias in node.names:
                name = f"{origin}.{alias.name}"
                found.add(name if name in MODULES else origin)
    return {name for name in found if name.split(".")[0] in ("core", "wegs_cli")}


def faults(path: Path, source: str) -> list[str]:
    """What is wrong with the imports of a file, one line each."""
    own = part_of(module_of(path))
    if own not in HEIGHT:
        return [f"{own} has no layer: give it one in LAYERS"]
    wrong = []
    for name in sorted(imports_of(path, source)):
        target = part_of(name)
        if target not in HEIGHT:
            wrong.append(f"{name} has no layer: give it one in LAYERS")
        elif target != own and HEIGHT[target] >= HEIGHT[own]:
            wrong.append(f"{own} imports {name}, which is {'beside' if HEIGHT[target] == HEIGHT[own] else 'above'} it")
    return wrong


@pytest.mark.parametrize("path", SOURCES, ids=module_of)
def test_imports_point_down(path):
    assert faults(path, path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "place, line, fault",
    [
        ("core/scene/camera.py", "from core.rasterizer import create", "above"),
        ("core/scene/camera.py", "from .. import training", "above"),
        ("core/evaluation/metrics.py", "import core.training.losses.regularisers", "beside"),
        ("core/data/split.py", "def late():\n    from core.export import ply", "beside"),
        ("core/looks/trained.py", "from core.pipeline.training import train", "above"),
        ("core/pipeline/baking.py", "from core.bench import suite", "above"),
        ("core/pipeline/training.py", "from core.doctor.views import cameras_beside", "beside"),
        ("core/pipeline/__init__.py", "from ..bench import suite", "above"),
        ("core/errors.py", "from core import config", "above"),
        ("core/config.py", "import wegs_cli.main", "above"),
        ("core/novelty.py", "import numpy", "no layer"),
        ("core/scene/camera.py", "import core.novelty", "no layer"),
    ],
)
def test_the_walk_finds_faults(place, line, fault):
    assert [fault in found for found in faults(ROOT / place, line)] == [True]


@pytest.mark.parametrize(
    "place, line",
    [
        ("core/rasterizer/cpu/backend.py", "from core.rasterizer.contract import NEAR\nfrom core.scene import camera"),
        ("core/pipeline/interpolating.py", "from core.looks.trained import bake\nfrom core.pipeline.baking import ONE_LOOK"),
        ("core/training/trainer.py", "import torch\nfrom core.errors import BadInput\nfrom . import regularisers"),
        (
            "wegs_cli/main.py",
            "from core import __version__\nfrom core.pipeline import train\nfrom wegs_cli import options",
        ),
    ],
)
def test_the_walk_lets_good_imports_pass(place, line):
    assert faults(ROOT / place, line) == []


def test_triton_is_imported_only_when_cuda_is_asked_for():
    """By modules that no other imports at its top: the CPU build of torch lacks Triton."""
    texts = {path: path.read_text(encoding="utf-8") for path in SOURCES}
    own = {path for path, source in texts.items() if "\nimport triton" in source or "\nfrom triton" in source}
    own |= {path for path in SOURCES if path.parent == ROOT / "core/rasterizer/cuda"}
    assert ROOT / "core/rasterizer/cuda/project.py" in own
    names = {module_of(path) for path in own}
    for path in texts.keys() - own:
        at_top = [node for node in ast.parse(texts[path]).body if isinstance(node, (ast.Import, ast.ImportFrom))]
        assert not imports_of(path, "\n".join(map(ast.unparse, at_top))) & names, path


def test_files_stay_short():
    files = [*SOURCES, *ROOT.glob("tests/**/*.py"), *ROOT.glob("samples/**/*.py")]
    lengths = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in files}
    assert {path: length for path, length in lengths.items() if length > LONGEST_FILE} == {}

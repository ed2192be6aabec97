"""The structure of the code: imports point down, files stay readable, and Triton is not needed without a GPU."""

import ast
import importlib.util
import re
import tomllib

from tests.paths import ROOT
from tests.programs import run_python

LONGEST_FILE = 350
SOURCES = sorted([*ROOT.glob("core/**/*.py"), *ROOT.glob("wegs_cli/**/*.py")])
CUDA = ROOT / "core" / "rasterizer" / "cuda"
MAPPED = ("appearance", "bench", "data", "pipeline", "rasterizer", "run", "training")  # docstrings that list modules
LINT = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
IMPORT_WITHOUT_TRITON = """
import sys
from importlib import import_module
sys.modules |= dict.fromkeys(["triton", "core.rasterizer.cuda"])  # importing these raises
for name in sys.argv[1:]:
    import_module(name)
"""


def test_imports_point_down():
    """As [tool.importlinter] in pyproject.toml says."""
    # Others are not looked at.
    assert {path.parent for path in SOURCES} == {path.parent for path in SOURCES if path.name == "__init__.py"}
    run_python(LINT)


def test_triton_is_imported_only_when_cuda_is_asked_for():
    """Modules that import it are not imported at the top of any other: the CPU build of torch lacks Triton."""
    triton = re.compile(r"^(import|from) (triton|core\.rasterizer\.cuda)", re.MULTILINE)
    others = [path for path in SOURCES if path.parent != CUDA and not triton.search(path.read_text(encoding="utf-8"))]
    names = [".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in others]
    run_python(IMPORT_WITHOUT_TRITON, *names)


def test_files_stay_short():
    files = [*SOURCES, *ROOT.glob("tests/**/*.py"), *ROOT.glob("samples/**/*.py")]
    lengths = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in files}
    assert {path: length for path, length in lengths.items() if length > LONGEST_FILE} == {}


def test_the_modules_whose_shapes_are_checked_exist():
    options = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]["addopts"]
    modules = options.partition("--jaxtyping-packages=")[2].split(" ")[0].split(",")
    found = [name for name in modules if name.startswith("core.") and importlib.util.find_spec(name)]
    assert found == [name for name in modules if name.startswith("core.")] and len(found) > 20


def test_a_package_that_lists_its_modules_lists_them_all():
    unlisted = []
    for folder in (ROOT / "core" / name for name in MAPPED):
        listed = re.findall(r"\w+", ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))))
        unlisted += [path for path in folder.glob("[a-z]*.py") if path.stem.removesuffix("_cuda") not in listed]
    assert unlisted == []

"""Photos -> scene -> trained run -> .ply: the sequence of steps behind the commands, a file each.
The command line is a thin skin over it.

cameras        photos without cameras become a scene                                       `wegs sfm`
training       a scene becomes a trained run; a stopped run is resumed                     `wegs train`
baking         the run in one look, named or read from a photo, becomes a file             `wegs bake`
interpolating  a fade from one look to another becomes frames and, if wanted, .ply files   `wegs interpolate`
evaluating     the run is measured against the photos that were held out                   `wegs eval`

`opened` finds and loads the run that a command works on. `wegs doctor` and `wegs bench` are in core.doctor and
core.bench. No file has the name of a function: `core.pipeline.train` is the function.
"""

from core.pipeline.baking import bake_to_file
from core.pipeline.cameras import find_cameras
from core.pipeline.evaluating import evaluate
from core.pipeline.interpolating import interpolate
from core.pipeline.training import resume, train

__all__ = ["bake_to_file", "evaluate", "find_cameras", "interpolate", "resume", "train"]

"""The picture at the top of the README: one scene from one camera in six lights, from the newest run of samples/plaza.

    python samples/lights.py [RUN]
"""

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does, before torch is imported
HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import numpy as np

from core import pipeline
from core.export.pictures import to_8_bit, write_png
from core.training import run

VIEW = "0006.jpg"  # held out
STYLES = HERE / "plaza/styles"
LOOKS = ("neutral", "0006.jpg", "0027.jpg", "0058.jpg", str(STYLES / "noon.jpg"), str(STYLES / "dusk.jpg"))
WIDTH = 320  # px of each picture


def main() -> None:
    trained = pipeline.load_run(run.find_run(Path(sys.argv[1]) if len(sys.argv) > 1 else None))
    photo = next(photo for photo in trained.collection.photos if photo.name == VIEW)
    camera = photo.camera.resized(WIDTH, round(WIDTH * photo.camera.height / photo.camera.width))
    rasterizer = trained.rasterizer
    pictures = []
    for look in LOOKS:
        splats = pipeline.bake(trained, pipeline.find_appearance(trained, look))
        pictures.append(to_8_bit(rasterizer.render(splats, camera).image))
    rows = [np.concatenate(pictures[start : start + 3], axis=1) for start in (0, 3)]
    write_png(HERE / "lights.png", np.concatenate(rows))


if __name__ == "__main__":
    main()

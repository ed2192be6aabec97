"""The files of a run folder that viewers of the original 3DGS project read, beside point_cloud/:
input.ply, cameras.json, cfg_args."""

from pathlib import Path

from core.data.collection import Collection
from core.export.ply import write_points
from core.scene.harmonics import MAX_DEGREE
from core.system.atomic import write_json, write_text

CFG_ARGS, CAMERAS, POINTS = "cfg_args", "cameras.json", "input.ply"


def write(folder: Path, collection: Collection, white_background: bool) -> None:
    """Write all three. white_background: viewers are to draw the scene over white."""
    points = collection.frame.for_files().to_world(collection.points)
    write_points(folder / POINTS, points, collection.point_colours)
    write_json(folder / CAMERAS, _cameras_json(collection))
    write_text(folder / CFG_ARGS, _cfg_args(folder, collection, white_background))


def _cameras_json(collection: Collection) -> list[dict]:
    """Training views first; position and rotation lead from camera (OpenCV axes) to world."""
    entries = []
    for number, photo in enumerate((*collection.split("train"), *collection.split("test"))):
        camera = photo.camera.in_world(collection.frame.for_files())
        entries.append(
            {
                "id": number,
                "img_name": photo.name,
                "width": camera.width,
                "height": camera.height,
                "position": camera.centre.tolist(),
                "rotation": camera.world_to_camera.T.tolist(),
                "fy": camera.fy,
                "fx": camera.fx,
                "cx": camera.cx,  # not in the original's, which puts it in the middle
                "cy": camera.cy,
            }
        )
    return entries


def _cfg_args(folder: Path, collection: Collection, white_background: bool) -> str:
    """The printed argparse.Namespace from which the original's viewer takes the source folder and the SH degree."""
    fields = {
        "sh_degree": MAX_DEGREE,  # of the file, not of the run: the viewer derives from it how long a row is
        "source_path": str(collection.root.resolve()),
        "model_path": str(folder.resolve()),
        "images": "images",
        "resolution": -1,
        "white_background": white_background,
        "data_device": "cpu",
        "eval": bool(collection.split("test")),
    }
    return "Namespace(" + ", ".join(f"{name}={value!r}" for name, value in fields.items()) + ")"

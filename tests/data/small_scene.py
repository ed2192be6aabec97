"""A small COLMAP scene made on the fly: known points and cameras, and photos that show each point as a soft dot."""

import struct
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pycolmap

WIDTH, HEIGHT = 160, 120
FOCAL = 150.0
DOT_PX = 2.0  # standard deviation: wide enough for a centroid to survive JPEG, resampling and resizing

# Each model with parameters that move a corner by 2 to 10 px.
LENSES = {
    "SIMPLE_PINHOLE": [FOCAL, 80, 60],
    "PINHOLE": [FOCAL, FOCAL * 1.1, 78, 63],
    "SIMPLE_RADIAL": [FOCAL, 80, 60, -0.15],
    "RADIAL": [FOCAL, 82, 58, -0.15, 0.05],
    "OPENCV": [FOCAL, FOCAL * 1.1, 80, 60, 0.12, -0.03, 0.004, -0.006],
    "FULL_OPENCV": [FOCAL, FOCAL, 80, 60, -0.1, 0.02, 0.003, 0.002, 0.01, 0.02, -0.01, 0.002],
    "SIMPLE_RADIAL_FISHEYE": [FOCAL, 80, 60, 0.05],
    "OPENCV_FISHEYE": [FOCAL, FOCAL, 80, 60, 0.05, -0.02, 0.01, 0.0],
    "RADIAL_FISHEYE": [FOCAL, 80, 60, 0.05, -0.02],
    "THIN_PRISM_FISHEYE": [FOCAL, FOCAL, 80, 60, 0.05, -0.02, 0.002, 0.001, 0.01, 0.0, 0.001, 0.001],
    "RAD_TAN_THIN_PRISM_FISHEYE": [
        FOCAL,
        FOCAL,
        80,
        60,
        0.05,
        -0.02,
        0.01,
        0.0,
        0.0,
        0.0,
        0.002,
        0.001,
        0.001,
        0.001,
        0.001,
        0.001,
    ],
    "SIMPLE_FISHEYE": [FOCAL, 80, 60],
    "FISHEYE": [FOCAL, FOCAL, 80, 60],
    "FOV": [FOCAL, FOCAL, 80, 60, 0.4],
    "SIMPLE_DIVISION": [FOCAL, 80, 60, -0.1],
    "DIVISION": [FOCAL, FOCAL, 80, 60, -0.1],
    "EUCM": [FOCAL, FOCAL, 80, 60, 0.5, 1.1],
}


def grid_points() -> np.ndarray:
    """20 points (20, 3) about 3 units before the cameras, far enough apart in the picture to be told apart."""
    x, y = np.meshgrid(np.linspace(-1.1, 1.1, 5), np.linspace(-0.75, 0.75, 4))
    return np.stack([x.ravel(), y.ravel(), 3 + 0.2 * np.sin(5 * x + 3 * y).ravel()], axis=1)


@dataclass
class SmallScene:
    """What to build; change a field, then call `write`. Camera i stands a little to the side of camera i - 1."""

    names: list[str] = field(default_factory=lambda: [f"photo_{index}.png" for index in range(4)])
    model: str = "PINHOLE"
    params: list[float] | None = None
    points: np.ndarray = field(default_factory=grid_points)
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))  # moves the whole world
    unit: float = 1.0  # scales the whole world
    scale: float = 1.0  # size of the photos on disk against the model's

    def lens(self) -> pycolmap.Camera:
        params = LENSES[self.model] if self.params is None else self.params
        return pycolmap.Camera(camera_id=1, model=self.model, width=WIDTH, height=HEIGHT, params=params)

    def pose(self, index: int) -> pycolmap.Rigid3d:
        """Camera from world, for a camera at (0.05 index, 0, 0) + offset that looks along z, a little rolled."""
        rotation = pycolmap.Rotation3d(np.array([0.0, 0.0, 0.02 * index]))
        centre = self.unit * np.array([0.05 * index, 0.0, 0.0]) + self.offset
        return pycolmap.Rigid3d(rotation, -rotation.matrix() @ centre)

    def reconstruction(self) -> pycolmap.Reconstruction:
        """The model; every photo sees every point."""
        made = pycolmap.Reconstruction()
        made.add_camera_with_trivial_rig(self.lens())
        for index, name in enumerate(self.names):
            seen = np.nan_to_num(self.seen(index))
            image = pycolmap.Image(name=name, keypoints=seen, camera_id=1, image_id=index + 1)
            made.add_image_with_trivial_frame(image, self.pose(index))
        for row, point in enumerate(self.points):
            track = pycolmap.Track()
            for index in range(len(self.names)):
                track.add_element(index + 1, row)
            made.add_point3D(
                self.unit * point + self.offset, track, np.array([row * 10 % 256, (255 - row) % 256, 7], np.uint8)
            )
        return made

    def seen(self, index: int) -> np.ndarray:
        """Where photo `index` shows the points: (P, 2) px of the model's size, through the lens."""
        pose = self.pose(index)
        world = self.unit * self.points + self.offset
        local = world @ pose.rotation.matrix().T + pose.translation
        return self.lens().img_from_cam(local)

    def write(self, root: Path, images: str = "images", sparse: str = "sparse/0") -> Path:
        """Photos and binary model below `root`, which is returned."""
        (root / images).mkdir(parents=True, exist_ok=True)
        (root / sparse).mkdir(parents=True, exist_ok=True)
        self.reconstruction().write_binary(str(root / sparse))
        width, height = round(WIDTH * self.scale), round(HEIGHT * self.scale)
        for index, name in enumerate(self.names):
            picture = draw_dots(self.seen(index) * self.scale, width, height)
            (root / images / name).parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(root / images / name), picture)
        return root

    def in_text(self, root: Path) -> Path:
        """The folder of the model below `root`, which is in text from now on."""
        model = root / "sparse" / "0"
        self.reconstruction().write_text(str(model))
        for path in model.glob("*.bin"):
            path.unlink()
        return model


def draw_dots(positions: np.ndarray, width: int, height: int, sigma: float = DOT_PX) -> np.ndarray:
    """A black picture (height, width, 3) uint8 with a white soft dot at each (x, y) px (pixel centres at .5)."""
    y, x = np.mgrid[:height, :width] + 0.5
    picture = np.zeros((height, width))
    for column, row in positions:
        picture += np.exp(-((x - column) ** 2 + (y - row) ** 2) / (2 * sigma**2))
    return np.repeat((picture.clip(0, 1) * 255).round().astype(np.uint8)[..., None], 3, axis=2)


def centroid(picture: np.ndarray, near: np.ndarray, reach: float) -> np.ndarray:
    """The centre (x, y) px of the light within `reach` px of `near`."""
    height, width = picture.shape[:2]
    y, x = np.mgrid[:height, :width] + 0.5
    weight = picture[..., 0].astype(float) * ((x - near[0]) ** 2 + (y - near[1]) ** 2 <= reach**2)
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


def exif_block(orientation: int, order: str = "<") -> bytes:
    """A minimal EXIF block: orientation, and a focal length of 35 mm that must survive turning."""
    head = {"<": b"II*\0", ">": b"MM\0*"}[order] + struct.pack(order + "I", 8)
    entries = [
        struct.pack(order + "HHIHH", 0x0112, 3, 1, orientation, 0),
        struct.pack(order + "HHIHH", 0xA405, 3, 1, 35, 0),
    ]
    return head + struct.pack(order + "H", len(entries)) + b"".join(entries) + struct.pack(order + "I", 0)


def add_exif(path: Path, block: bytes) -> None:
    """Put an EXIF block into the JPEG, PNG or lossless WebP at `path`."""
    data = path.read_bytes()
    if data[:2] == b"\xff\xd8":
        body = b"Exif\0\0" + block
        data = data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]
    elif data[:4] == b"RIFF":
        sides, flags = int.from_bytes(data[21:25], "little"), 0x08 | data[24] & 0x10  # EXIF; alpha, as the picture says
        canvas = bytes([flags, 0, 0, 0]) + b"".join((sides >> bits & 0x3FFF).to_bytes(3, "little") for bits in (0, 14))
        parts = ((b"VP8X", canvas), (data[12:16], data[20:]), (b"EXIF", block))
        body = b"WEBP" + b"".join(kind + struct.pack("<I", len(part)) + part for kind, part in parts)
        data = b"RIFF" + struct.pack("<I", len(body)) + body
    else:
        import zlib

        chunk = b"eXIf" + block
        data = data[:33] + struct.pack(">I", len(block)) + chunk + struct.pack(">I", zlib.crc32(chunk)) + data[33:]
    path.write_bytes(data)

"""Where the project itself lies."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PLAZA = ROOT / "samples" / "plaza"  # the sample scene

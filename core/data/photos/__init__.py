"""Photo files and their pixels: found in a folder, read, undistorted, holes filled."""

"""What plain photos lack: cameras by structure from motion, points by triangulation, the camera of one more photo."""

"""The maker of samples/plaza: a ray-cast landmark, its tourists, its weather, its cameras and its COLMAP model."""

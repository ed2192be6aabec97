"""What other programs write: cameras and points, each format read into a Posed."""

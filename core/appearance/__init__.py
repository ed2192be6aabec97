"""How looks differ: photo -> embedding and mask (encoder), embedding -> colours of the Gaussians (transfer)."""

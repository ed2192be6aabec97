"""How looks differ: photo -> embedding and mask, embedding -> colours of the Gaussians.

all of it             model
photo -> embedding    encoder, attention; mask_table, of an ablation
embedding -> colours  sh_transfer, positional_encoding (_cuda); exposure, where looks differ by an affine map at most
the transfer's MLP    transfer_mlp, transfer_kernels, transfer_arithmetic, matrix_product
a look                colouring; refinement, against a photo whose camera is known; strangeness, of what a photo shows
photos from outside   known_range, tone
"""

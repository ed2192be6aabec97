"""Error against run time: one module a curve, one `Figure` for all of them, one module that draws it."""

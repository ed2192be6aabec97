"""Error against run time: one module a curve, one `Figure` for all of them, one module that draws it."""

FIGURES = (
    "rendering",
    "baking",
    "training",
    "refinement",
)  # what `wegs bench` can measure, in the order in which it does

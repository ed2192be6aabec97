"""Error against run time, as work-precision figures.

which, of what, where to  suite
what is measured          rendering (levers), baking, training, refinement
with what                 stopwatch, differences, machine, small_scene
what comes of it          figure, drawing, files
"""

FIGURES = ("rendering", "baking", "training", "refinement")  # what `wegs bench` can measure, in the order in which it does

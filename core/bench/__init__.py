"""Error against run time, as work-precision figures.

suite                                       which figures are made, of what, and where they go
rendering (levers), baking,                 the measurements, each of which returns a Figure
training, refinement
stopwatch, differences, machine,            what they measure with, and on
small_scene
figure, drawing, files                      a Figure as data, as a picture, and as files
"""

# What `wegs bench` can measure, in the order in which it does.
FIGURES = ("rendering", "baking", "training", "refinement")

"""The command line: `wegs train`, `wegs bake` and the rest.
Everything it does is a call into core.pipeline, core.bench or core.doctor."""

INTERRUPTED = 130  # the exit code that shells report for Ctrl-C

"""`python -m wegs_cli` is `wegs`, also where that is not on the PATH."""

from wegs_cli.main import run

if __name__ == "__main__":
    run()

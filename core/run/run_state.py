"""Where a run stands: what a checkpoint holds beside Gaussians, networks, optimizer and random generator."""

from dataclasses import asdict, dataclass


@dataclass
class RunState:
    """Where a run stands after some steps."""

    done: int  # steps
    seconds: float  # of training, without the checks of held-out photos
    order: list[int]  # the photos left in this round through all of them, by index; the last one is next
    mask_mean: float  # running mean of the masks, 1 where nothing is hidden
    last_losses: list[float | None]  # see `guards.LastLosses`
    skipped: int  # invalid steps
    skipped_in_a_row: int  # invalid steps in a row
    collapse_told: bool  # whether the user was told that masks hide too much
    # Checkpoints of earlier versions lack these.
    useless: int = 0  # Gaussians removed because no photo needed them
    change_due: bool = False  # whether density control has yet to change the Gaussians after these steps

    @staticmethod
    def at_start(photos: int) -> "RunState":
        """Of a run on so many photos, before its first step."""
        return RunState(
            done=0,
            seconds=0.0,
            order=[],
            mask_mean=1.0,
            last_losses=[None] * photos,
            skipped=0,
            skipped_in_a_row=0,
            collapse_told=False,
        )

    @staticmethod
    def of_facts(facts: dict) -> "RunState":
        """The inverse of `facts`; KeyError or TypeError if one without a default is missing."""
        return RunState(**facts["trainer"] | {"done": facts["step"]})

    def facts(self) -> dict:
        """What a checkpoint says of it: the steps, which every reader wants, as its `step`."""
        state = asdict(self)
        return {"step": state.pop("done"), "trainer": state}

    def check_photos(self, photos: int) -> None:
        """Raise ValueError if it is of a run on another number of photos."""
        if len(self.last_losses) != photos or not set(self.order) <= set(range(photos)):
            raise ValueError(f"losses or an order of other photos than these {photos}")

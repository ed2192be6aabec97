"""What one camera sees of a trained run, in any look."""

from functools import cached_property
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float, Int
from torch import Tensor

from core.appearance.colouring import Colouring
from core.appearance.refinement import FARTHEST, UNSEEN_PX
from core.appearance.sh_transfer import TransferInput
from core.appearance.tone import toned
from core.scene.camera import Camera
from core.scene.cells import cell_sums
from core.scene.harmonics import basis, evaluated
from core.scene.splats import Splats
from core.system.device import sent

if TYPE_CHECKING:
    from core.looks.trained import TrainedRun


class RunView:
    """The view in any look, as `bake` gives it: a core.appearance.refinement.Refinable."""

    def __init__(self, trained: "TrainedRun", camera: Camera):
        self.trained, self.camera = trained, camera
        self.given_spread, self.hidden_weights = trained.given_spread, trained.model.hidden_weights
        self.visible = trained.rasterizer.visible(trained.splats, camera)
        solid = trained.solid_count
        rows = self.visible.rows
        self.place, self.discs = rows[rows < solid], rows[rows >= solid] - solid
        self.smooth_sky = trained.smooth_sky.of_discs(self.discs) if trained.smooth_sky and len(self.discs) else None
        self.sources = trained.base(
            rows if self.smooth_sky is None else torch.cat([self.place, self.smooth_sky.shown + solid])
        )
        self.in_view = trained.splats[rows]

    def render(self, look: Colouring) -> Float[Tensor, "h w 3"]:
        """The view in this look; differentiable by whatever of the look it depends on."""
        return self.trained.rasterizer.render(
            self.in_look(look), self.camera, self.trained.background, known=self.visible.known
        )

    def in_look(self, look: Colouring) -> Splats:
        """The Gaussians in view, in this look; differentiable as `render`."""
        sh = self._harmonics(self.sources, look)
        if self.smooth_sky is not None:
            place = len(self.place)
            sh = torch.cat([sh[:place], self.smooth_sky.sh(sh[place:])])
        seen = self.in_view.with_sh(sh)
        return seen if look.tone is None else toned(seen, look.tone, len(self.discs))

    def in_cells(self, weight: Float[Tensor, "h w"]) -> "RunInCells":
        """The view in cells; `weight` is how much each pixel counts."""
        return RunInCells(self, weight)

    def harmonics(self, rows: Int[Tensor, " r"], look: Colouring) -> Float[Tensor, "r c 3"]:
        """The SH of these Gaussians in this look, before tone and smooth sky; differentiable as `render`."""
        return self._harmonics(self.trained.base(rows), look)

    def _harmonics(self, base: TransferInput, look: Colouring) -> Float[Tensor, "r c 3"]:
        return self.trained.model.transfer(base, look.embedding, look.changes)[0]

    def bound(self, embedding: Float[Tensor, " e"]) -> Float[Tensor, " e"]:
        """The embedding or, if it lies too far out, the nearest that a refinement may reach."""
        return self.trained.known_range.nearest(embedding, FARTHEST)


class RunInCells:
    """A RunView in cells: a core.appearance.refinement.InCells."""

    def __init__(self, view: RunView, weight: Float[Tensor, "h w"]):
        self.view, trained = view, view.trained
        self.shares = trained.rasterizer.shares(view.in_view, view.camera, weight)
        light_left = cell_sums(weight[..., None]) - self.shares.of_cells()[:, None]
        self.background = light_left * sent(torch.tensor(trained.background), weight.device)
        directions = view.in_view.means - sent(torch.tensor(view.camera.centre, dtype=torch.float32), weight.device)
        self.basis = basis(torch.nn.functional.normalize(directions, dim=1), view.in_view.degree)

    def sums(self, look: Colouring) -> Float[Tensor, "cells 3"]:
        """The sums of the pixels of each cell in this look; differentiable by whatever of the look they depend on."""
        sh = self.view.in_look(look).sh
        colours = (evaluated(self.basis, sh) + 0.5).clamp_min(0)
        return self.shares.mixed(colours) + self.background

    @cached_property
    def sky(self) -> Float[Tensor, " cells"] | None:
        """How much of each cell is sky, px; None without a dome."""
        view = self.view
        if not view.trained.sky_count:
            return None
        is_sky = torch.zeros(len(view.in_view), 1, device=view.in_view.means.device)
        is_sky[len(view.place) :] = 1
        return self.shares.mixed(is_sky)[:, 0]

    @property
    def unseen(self) -> Int[Tensor, " u"]:
        """Rows of the Gaussians of which less than UNSEEN_PX is in view:
        they are outside the view, behind something, or where no pixel counts."""
        unseen = self.view.trained.splats.finite_rows()
        unseen[self.view.visible.rows[self.shares.of_gaussians() >= UNSEEN_PX]] = False
        return unseen.nonzero()[:, 0]

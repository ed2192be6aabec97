"""What the doctor says: one line for each check."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """The result of a check. figure: what was found. meaning: why it matters, or empty.
    advice: what to do, if anything.

    elsewhere: the advice for a file that wegs did not write, where wegs' own commands and settings do not help; empty
    if it is the same.
    """

    name: str
    figure: str
    meaning: str
    advice: str = ""
    elsewhere: str = ""

    def line(self) -> str:
        """The finding in one line, marked `ok` or `!!`."""
        mark, advice = ("!!", f" {self.advice}") if self.advice else ("ok", "")
        meaning = f" - {self.meaning}." if self.meaning else ""
        return f"{mark} {self.name}: {self.figure}{meaning}{advice}"


def counting(name: str, count: int, total: int, meaning: str, advice: str = "", elsewhere: str = "") -> Finding:
    """The finding that `count` of `total` are what its name says; without an explanation if none are."""
    return Finding(name, part(count, total), meaning, advice, elsewhere) if count else Finding(name, "none", "")


def verdict(findings: Sequence[Finding]) -> str:
    """The last line: how many findings need attention, and which."""
    open_ones = [finding.name for finding in findings if finding.advice]
    if not open_ones:
        return f"Verdict: sound; {len(findings)} checks, nothing to do."
    need = "needs" if len(open_ones) == 1 else "need"
    return (
        f"Verdict: {len(open_ones)} of {len(findings)} checks {need} attention: {', '.join(dict.fromkeys(open_ones))}."
    )


def part(count: int, total: int) -> str:
    """`count` and its share: "12 (0.4 %)"."""
    share = 100 * count / max(total, 1)
    return f"{count:,} ({share:{'.0f' if share >= 99.5 else '.2g'}} %)" if count else "0"

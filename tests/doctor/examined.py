"""An examination by the doctor, for tests."""

from core.doctor import examine
from tests.heard import Heard


def examined(path) -> tuple[dict, Heard]:
    heard = Heard()
    return {finding.name: finding for finding in examine(path, heard)}, heard


def asked_for(findings: dict) -> set[str]:
    return {name for name, finding in findings.items() if finding.advice}

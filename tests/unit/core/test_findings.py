import pytest

from calichrome.core.findings import SEVERITIES, Finding, finding, worst_severity


def test_a_finding_has_the_severity_of_its_code() -> None:
    found = finding("unsynchronised", "left and right disagree", camera="left", rms_px=30.5)
    assert found.severity == "critical"
    assert found.data == {"camera": "left", "rms_px": 30.5}


def test_unknown_codes_are_refused() -> None:
    with pytest.raises(KeyError):
        finding("surprise", "?")


@pytest.mark.parametrize(
    ("codes", "worst"),
    [
        ([], None),
        (["small_board"], "note"),
        (["small_board", "few_views", "small_board"], "warning"),
        (["few_views", "weak_geometry", "small_board"], "critical"),
    ],
)
def test_the_worst_severity_decides(codes: list[str], worst: str | None) -> None:
    findings: list[Finding] = [finding(code, "") for code in codes]
    assert worst_severity(findings) == worst


def test_severities_are_known() -> None:
    assert set(SEVERITIES.values()) <= {"note", "warning", "critical"}

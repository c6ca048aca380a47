"""Notes of stage 30 on rows of a log that contradict the contact law of its labels."""

from gelforge.flow.tables import InterfaceTable
from gelforge.records.press import PosedPress
from gelforge.stages.fea import friction_notes
from tests.support.press_records import press_record


def pressed(name: str, travel: float = 0.0, force: tuple[float | None, ...] = (None, None, None)) -> PosedPress:
    facts = vars(press_record(sample_id=name)) | {"dx_mm": travel, "dy_mm": 0.0, "z0_mm": 0.0, "dz_mm": -0.5}
    facts |= dict(zip(("fx_n", "fy_n", "fz_n"), force, strict=True))
    return PosedPress(**{key: value for key, value in facts.items() if key != "time_utc"})


def law(name: str, mu: float = 0.5) -> InterfaceTable:
    return InterfaceTable(law=name, mu=mu, mu_error=0.2)


def test_a_reading_beyond_the_law_is_named():
    strong, held = pressed("strong", force=(0.8, 0.6, -1.0)), pressed("held", force=(0.3, 0.4, -1.0))
    weak, unread = pressed("weak", force=(0.1, 0.0, -0.05)), pressed("unread")
    (note,) = friction_notes([strong, held, weak, unread], law("coulomb"))
    assert note.startswith("strong:") and "0.5 times" in note
    assert not friction_notes([strong, held], law("coulomb", 1.0)) and not friction_notes([strong], law("no_slip"))
    (note,) = friction_notes([strong, held, weak, unread], law("frictionless"))
    assert note.startswith("strong, held:")


def test_a_slide_without_slip_is_named():
    rows = [pressed("far", 0.9), pressed("near", 0.3)]
    (note,) = friction_notes(rows, law("no_slip"))
    assert note.startswith("far:") and "coulomb" in note
    assert not friction_notes(rows, law("coulomb")) and not friction_notes(rows, law("frictionless"))

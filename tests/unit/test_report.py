"""The page holds everything itself, and nothing that data says becomes markup."""

import re

import numpy as np

from gelforge.reporting import pictures
from gelforge.reporting.page import Section, render
from gelforge.stages.report import failures_section, flatten, pick


def test_text_from_data_is_escaped():
    section = Section("Failures").table(["sample"], [["<script>alert(1)</script>"]]).text("a < b & c")
    page = render("<b>lab</b>", "lead", [section])
    assert "<script>" not in page and "<b>lab" not in page
    assert "&lt;script&gt;" in page and "a &lt; b &amp; c" in page


def test_the_page_asks_nothing_from_outside():
    label = np.zeros((3, 4, 5))
    picture = pictures.label_over_image(np.zeros((24, 32, 3), np.uint8), label, "none")
    page = render("lab", "lead", [Section("Labels").picture(picture, "a caption")])
    sources = re.findall(r'(?:src|href)="([^"]{0,30})', page)
    assert sources and all(s.startswith(("data:image/png;base64,", "#")) for s in sources)


def test_every_indenter_is_shown_before_any_comes_twice():
    rows = [{"sample_id": str(k), "dz_mm": str(-k), "indenter": "ab"[k > 3]} for k in range(6)]
    solved = {row["sample_id"]: {"status": "OK"} for row in rows} | {"5": {"status": "DIVERGED"}}
    chosen = pick(rows, solved, 3)
    assert {row["indenter"] for row in chosen[:2]} == {"a", "b"} and "5" not in [row["sample_id"] for row in chosen]


def test_failures_are_listed_with_their_reasons(tmp_path):
    section = failures_section(
        tmp_path, {"s1": {"sample_id": "s1", "status": "DIVERGED", "reason": "why", "fidelity": "ccx"}}
    )
    assert any(["s1", "DIVERGED", "why", "ccx"] in item.get("rows", []) for item in section.items)
    assert "None" in failures_section(tmp_path, {}).items[0]["text"]


def test_leaves_of_nested_figures_keep_their_names():
    assert flatten({"a": {"b": 1, "c": [2]}, "d": "x"}) == [("a.b", 1), ("d", "x")]

"""Laws of the raw log: it reads back what was written, and survives any row."""

import csv
import io
from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.records import log, press
from gelforge.records.image import png_fault

NUMBERS = st.floats(-999.0, 999.0, allow_nan=False)
WORDS = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.\-]{0,20}", fullmatch=True)
SAMPLES = st.builds(
    press.LoggedPress,
    row=st.integers(2, 10**6),
    sample_id=WORDS,
    time_utc=st.just("2025-04-08T12:25:19+00:00"),
    sensor_id=WORDS,
    gel_id=WORDS,
    indenter=WORDS,
    image=WORDS,
    **{name: NUMBERS for name in press.POSE if name != "dz_mm"},
    dz_mm=st.floats(-999.0, -press.SHALLOW),
    **{name: st.none() | st.floats(-press.LARGEST[name], press.LARGEST[name]) for name in press.FORCES},
)


@given(samples=st.lists(SAMPLES, min_size=1, max_size=3))
@settings(max_examples=30)
def test_log_reads_back_to_the_last_digit(tmp_path_factory, samples):
    path = tmp_path_factory.mktemp("log") / "log.csv"
    log.write_log(path, samples)
    rows = log.read_log(path)
    for line, (sample, row) in enumerate(zip(samples, rows, strict=True), 2):
        back, wrong = press.parse(row, "log.csv")
        assert not wrong
        assert back == replace(sample, row=line)


ODD = ("nan", "-inf", "1e400", "1,5", "\x00", "=1+1", "../..", " 3 ", "--1", "0x1", "\u0663", "1e", ".", "2025-13-45")
CELLS = st.text(max_size=30) | st.sampled_from(ODD)


@given(cells=st.dictionaries(st.sampled_from([*press.KNOWN, "other"]), CELLS))
@settings(max_examples=150)
def test_any_row_is_either_typed_or_explained(cells):
    sample, wrong = press.parse(press.RawRow(2, cells), "log.csv")
    assert (sample is None) == bool(wrong)
    for rejection in wrong:
        assert rejection.reason and rejection.hint
        assert rejection.column in press.KNOWN
        # a rejection must survive the file it is written to
        text = io.StringIO()
        csv.writer(text).writerow([rejection.value, str(rejection)])
        assert text.getvalue().rstrip("\r\n").isprintable()


GOOD = "{},,s,g,ball,0,0,0,0,0,-1,0,,,-5,,,,i.png"
JUNK = st.text(st.characters(codec="utf-8", exclude_characters='\r\n"'), max_size=60) | st.sampled_from(
    ['""', 'x,"y"', 'a,b,""', "," * 30, "\x00", "\u2028", "'", '"a ""b"", c"']
)


@given(lines=st.lists(JUNK | st.integers(0, 99), max_size=12))
@settings(max_examples=150)
def test_no_line_of_a_log_keeps_another_press_out(tmp_path_factory, lines):
    path = tmp_path_factory.mktemp("log") / "log.csv"
    text = [GOOD.format(f"p{at}") if isinstance(line, int) else line for at, line in enumerate(lines)]
    path.write_text(
        "\n".join([",".join(press.COLUMNS), *text, GOOD.format("last")]) + "\n", encoding="utf-8", newline=""
    )
    found = {}
    for row in log.read_log(path):
        sample, wrong = press.parse(row, "log.csv")
        assert (sample is None) == bool(wrong) and row.row not in found
        found[row.row] = sample.sample_id if sample else None
    for at, line in enumerate(lines):
        if isinstance(line, int):
            assert found[at + 2] == f"p{at}"
    assert found[len(lines) + 2] == "last"


@given(data=st.binary(max_size=300), cut=st.integers(0, 200))
def test_no_bytes_break_the_image_check(data, cut):
    for attempt in (data, b"\x89PNG\r\n\x1a\n" + data, (b"\x89PNG\r\n\x1a\n" + data)[:cut]):
        fault, _ = png_fault(attempt)
        assert fault

"""YAML with one reading: numbers as they look, nothing twice, and what programs read differently refused."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import UnreadableFileError
from dvf_ig.intake import read_fixtures
from dvf_ig.intake.scenario import CONFIG, read_scenario_config
from dvf_ig.intake.session import open_session
from dvf_ig.io.yaml_text import parse_yaml, yaml_text

HERE = Path("f.yaml")


def read(text: str) -> Any:
    return parse_yaml(text, HERE, "a configuration")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2", 2),
        ("+2", 2),
        ("-0.5", -0.5),
        ("1.", 1.0),
        (".5", 0.5),
        ("1e3", 1000.0),
        ("1E-3", 0.001),
        ("+1.5e+2", 150.0),
        ("0e5", 0.0),
        ("true", True),
        ("False", False),
        ("~", None),
        ("", None),
        ("off", "off"),
        ("yes", "yes"),
        ("No", "No"),
        ("2020-13-45", "2020-13-45"),
        ("127.0.0.1", "127.0.0.1"),
        ("edf:ecg.edf", "edf:ecg.edf"),
        ("0,5", "0,5"),
        ("'010'", "010"),
        ('"1:30"', "1:30"),
        ("'null'", "null"),
    ],
)
def test_a_word_is_what_it_looks_like(text: str, value: Any) -> None:
    found = read(f"key: {text}")["key"]
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    "text",
    [
        "010",
        "-010",
        "00",
        "010.5",
        "01e3",
        "089",
        "0x10",
        "0X1f",
        "0b1",
        "0o17",
        "1_0",
        "1_0.5",
        ".5_0",
        "1e1_0",
        "1:30",
        "190:20:30",
        "1:30.5",
        "-1:30",
        "00:11:22",
    ],
)
def test_a_number_that_programs_read_differently_is_refused(text: str) -> None:
    for document in (f"a:\n  - depth_mm: {text}", f"{{a: [{{depth_mm: {text}}}]}}"):
        with pytest.raises(UnreadableFileError, match="read differently by different programs") as raised:
            read(document)
        assert f"a.0.depth_mm: {text} is" in str(raised.value)
    assert read(f"key: '{text}'") == {"key": text}


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("cap_n: 0.5\nmargin: off\ncap_n: 2", "line 3: 'cap_n' is given twice, first in line 1; keep one"),
        ("a: {b: 1, c: 2, b: 3}", "line 1, a: 'b' is given twice"),
        ("3: a\n'3': b", "line 2: '3' is given twice"),
        ("a: .inf", "line 1, a: .inf is not a finite number"),
        ("a: -.INF", "not a finite number"),
        ("a: .NaN", "not a finite number"),
        ("a: nan", "not a finite number"),
        ("a: 1e999", "more than a number can hold"),
        ("a: 1e-999", "more than a number can hold"),
        ("a: 99999999999999999999", "more than a number can hold"),
        ("a: &x 1\nb: 2", "line 1, a: the anchor '&x' is not supported; remove it"),
        ("a: 1\nb: *x", "line 2, b: the alias '*x' is not supported; write its value out"),
        ("*x : 1", "the alias '*x' is not supported"),
        ("<<: {a: 1}", "the merge key '<<' is not supported; write the keys out"),
        ("a: !!str 010", "line 1, a: the tag '!!str' is not supported"),
        ("a: !!python/object:os.system x", "the tag '!!python/object:os.system' is not supported"),
        ("? [1, 2]\n: 3", "a list or a mapping is not a key"),
        ("1.5: a", "'1.5' is not a key"),
        ("true: a", "'true' is not a key"),
        ("~: a", "'~' is not a key"),
        ("010: a", "read differently"),
        ("a: 1\n---\na: 2", "line 2: a second document begins"),
        ("[" * 50_000, "nested more than 100 deep"),
        ('a: "\\UFFFFFFFF"', "a character that does not exist"),
        ("a: [", "is not YAML: line 1"),
    ],
)
def test_what_has_no_one_reading_is_refused_with_line_and_key(text: str, complaint: str) -> None:
    with pytest.raises(UnreadableFileError) as raised:
        read(text)
    message = str(raised.value)
    assert message.startswith("f.yaml")
    assert complaint in message
    assert "\n" not in message


SCALARS = (
    st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")), max_size=12)
    | st.from_regex(r"[-+]?[0-9_.:xob]{1,6}(e[0-9]+)?", fullmatch=True)
    | st.sampled_from(["off", "null", "1e3", "0089", "nan", ".inf", "1:30", "<<", "=", "~", "true", "-"])
    | st.integers(-(10**15), 10**15)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.booleans()
    | st.none()
)


@given(st.dictionaries(st.text("abc0:.", min_size=1, max_size=4), st.lists(SCALARS, max_size=3), max_size=3))
def test_what_is_written_is_read_back(document: dict[str, Any]) -> None:
    for flow in (False, None, True):
        assert read(yaml_text(document, flow=flow)) == document


def test_fixtures_sessions_and_scenarios_are_read_by_it(tmp_path: Path) -> None:
    """Each of the three would have taken 2 N, or 8 mm."""
    fixtures = tmp_path / "fixtures.yaml"
    fixtures.write_text("cap_n: 0.5\nfixtures: [{law: forbidden}]\ncap_n: 2\n")
    with pytest.raises(UnreadableFileError, match=r"fixtures\.yaml: line 3: 'cap_n' is given twice"):
        read_fixtures(fixtures)
    fixtures.write_text("fixtures: [{law: forbidden, depth_mm: 010}]\n")
    with pytest.raises(UnreadableFileError, match=r"line 1, fixtures\.0\.depth_mm: 010 is read differently"):
        read_fixtures(fixtures)
    session = tmp_path / "session.yaml"
    session.write_text("schema: dvf_ig.session/1\ncap_n: 0.5\ncap_n: 2\n")
    with pytest.raises(UnreadableFileError, match=r"session\.yaml: line 3: 'cap_n' is given twice"):
        open_session(session)
    (tmp_path / CONFIG).write_text("schema: dvf_ig.scenario/1\nseed: 1\nseed: 2\n")
    with pytest.raises(UnreadableFileError, match=r"line 3: 'seed' is given twice"):
        read_scenario_config(tmp_path)


def test_numbers_of_every_decimal_form_reach_a_fixture(tmp_path: Path) -> None:
    path = tmp_path / "fixtures.yaml"
    path.write_text("margin: off\nfixtures: [{law: guidance, delta: 4e0, m: 1., depth_mm: +2, cap_n: .5}]\n")
    law = read_fixtures(path)[0].fixtures[0].law
    assert law.parameters.tolist()[1:] == [4.0, 1.0, 0.5, 2.0]


@pytest.mark.parametrize("value", ["'1_0'", "'10'", "true", "yes"])
def test_a_number_of_a_session_is_no_text_and_no_yes(tmp_path: Path, value: str) -> None:
    path = tmp_path / "session.yaml"
    for key in ("seed", "ecg.rate_hz", "ultrasound.fan.start_px", "preop.ed_phase"):
        *sections, last = key.split(".")
        text = "".join(f"{section}: {{" for section in sections) + f"{last}: {value}" + "}" * len(sections)
        path.write_text(f"schema: dvf_ig.session/1\n{text}\n")
        with pytest.raises(UnreadableFileError, match=rf"{key}: needed a (whole )?number"):
            open_session(path)


def test_a_backslash_in_double_quotes_is_explained(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match=r"unknown escape character 'd'; in double quotes . begins"):
        parse_yaml('model: "C:\\data\\a.npz"\n', tmp_path / "a.yaml", "a session")

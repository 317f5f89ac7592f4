"""JSON that every program reads alike: nothing twice, numbers that JSON has."""

from pathlib import Path

import pytest

from dvf_ig.core import UnreadableFileError
from dvf_ig.io import read_json, read_lag


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('{"lag_s": 0.1,\n "lag_s": 0.2}', "line 2: 'lag_s' is given twice in one object; keep one of them"),
        ('{"a": {"b": "}{\\"b\\":",\n"b": 1}}', "line 2: 'b' is given twice"),
        ('{"a": 1, "\\u0061": 2}', "line 1: 'a' is given twice"),
        ('[{"a": 1},\n{"a": 1,\n"x": [{"y": 1}],\n"a": 2}]', "line 4: 'a' is given twice"),
        ('{"a": "NaN",\n"b": [NaN]}', "line 2: NaN is not a JSON number; write a number, or null"),
        ("[-Infinity]", "line 1: -Infinity is not a JSON number"),
    ],
)
def test_what_programs_read_differently_is_refused_with_its_line(
    tmp_path: Path, text: str, complaint: str
) -> None:
    path = tmp_path / "a.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableFileError) as raised:
        read_json(path)
    assert str(raised.value).startswith(f"{path}: {complaint}")


def test_a_name_may_come_again_in_another_object(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text('[{"a": {"a": 1}}, {"a": "{\\"a\\": NaN, \\"a\\""}]', encoding="utf-8")
    assert read_json(path) == [{"a": {"a": 1}}, {"a": '{"a": NaN, "a"'}]


def test_a_calibration_with_two_lags_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "lag.json"
    path.write_text('{"lag_s": 0.03, "lag_s": -0.2}', encoding="utf-8")
    with pytest.raises(UnreadableFileError, match="'lag_s' is given twice"):
        read_lag(path)

"""The common form of findings: what it refuses, and what it is as JSON."""

import json
import math

import numpy as np
import pytest

import hexservo as hs
from hexservo.findings.evidence import Column, Table, as_data


def test_a_table_refuses_rows_of_another_length() -> None:
    columns = [Column("axis"), Column("margin", "N")]
    assert Table("margins", columns, [["x", 1.0], ["y", None]]).rows[1][1] is None
    with pytest.raises(ValueError, match=r"table 'margins': expected rows of 2 cells, got \['z'\]"):
        Table("margins", columns, [["x", 1.0], ["z"]])


def test_data_is_strict_json_whatever_numpy_gives() -> None:
    data = as_data(
        {
            "array": np.array([[1.5, np.nan], [np.inf, -2.0]]),
            "count": np.int64(3),
            "flag": np.bool_(True),
            "number": math.inf,
            "tuple": (1, "text", None, np.float64(0.25)),
            4: {"inner": [np.float32(0.5)]},
        }
    )
    assert data == {
        "array": [[1.5, None], [None, -2.0]],
        "count": 3,
        "flag": True,
        "number": None,
        "tuple": [1, "text", None, 0.25],
        "4": {"inner": [0.5]},
    }
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert type(data["flag"]) is bool


def test_a_lone_name_of_a_part_is_refused_in_words() -> None:
    with pytest.raises(ValueError, match=r"parts: expected a list of names, got the text 'drift'; write \['drift'\]"):
        hs.analyse(hs.load_scenario("paper"), "drift")

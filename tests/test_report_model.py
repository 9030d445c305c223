"""tools/report/model.py: the order of a model of texture, its size and its quality."""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec

import pytest
from spec import ROOT

sys.path.insert(0, str(ROOT / "tools"))

from report import model
from report.section import Options
from report.texts import plain


@pytest.fixture(scope="module")
def short():
    return model.section(Options(quick=True))


def test_every_order_is_there_and_one_is_taken(short):
    rows = [model.Modelled(*row) for row in short.tables[0].rows]
    assert {row.order for row in rows} >= set(model.ORDERS)
    assert sum(row.chosen for row in rows) == 1
    assert len(short.tables[0].headers) == len(model.Modelled._fields)


def test_more_coefficients_cost_more_and_come_nearer(short):
    rows = {row[2]: model.Modelled(*row) for row in short.tables[0].rows}
    assert rows[8].bits_per_s < rows[16].bits_per_s < rows[32].bits_per_s < 400
    assert rows[8].error_db < rows[0].error_db
    taken = next(row for row in rows.values() if row.chosen)
    assert taken.error_db <= taken.own_db


def test_data_is_json_and_the_first_sentence_a_finding(short):
    assert len(json.loads(json.dumps(plain(short.data), allow_nan=False))) == len(
        short.tables[0].rows
    )
    assert short.text.startswith("A model of ") and "nan" not in short.text
    if find_spec("matplotlib"):
        assert all(figure.svg.startswith("<svg") for figure in short.figures)

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


def test_every_codec_is_beside_the_model(short):
    rows = [model.Beside(*row) for row in short.tables[1].rows]
    assert {row.codec for row in rows} == {model.MODEL, *model.SHOWN}
    assert len(short.tables[1].headers) == len(model.Beside._fields)
    made = next(row for row in rows if row.codec == model.MODEL)
    assert made.snr_db < 0
    for codec in model.SHOWN:
        own = [row for row in rows if row.codec == codec]
        assert own[0].bits_per_s < own[-1].bits_per_s and own[0].error_db > own[-1].error_db
        assert own[-1].snr_db > 15


def test_data_is_json_and_the_first_sentence_a_finding(short):
    found = json.loads(json.dumps(plain(short.data), allow_nan=False))
    assert [len(found[name]) for name in ("orders", "beside")] == [
        len(table.rows) for table in short.tables
    ]
    assert short.text.startswith("A model of ") and "nan" not in short.text
    if find_spec("matplotlib"):
        assert all(figure.svg.startswith("<svg") for figure in short.figures)

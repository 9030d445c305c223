"""Formats of other packages: the one of docs/plug-ins.md, and packages with faults."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from depth import deep
from pages import blocks, shape
from spec import ROOT

import hapfmt
from hapfmt import ParameterError
from hapfmt.convert.formats import OURS, Format, formats
from hapfmt.errors import DataWarning

PAGE = ROOT / "docs" / "plug-ins.md"


@pytest.fixture(autouse=True)
def fresh():
    """Each test looks for the installed formats anew."""
    formats.cache_clear()
    yield
    formats.cache_clear()


def install(folder: Path, module: str, code: str, *, point: str | None = None) -> None:
    """What pip leaves in an environment: a module, and the metadata of its package."""
    (folder / f"{module}.py").write_text(code)
    about = folder / f"{module}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    point = point or f"{module} = {module}:FORMAT"
    (about / "entry_points.txt").write_text(f"[hapfmt.formats]\n{point}\n")


def hapfmt_in(folder: Path, *words: str, path: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "hapfmt", *words], cwd=folder, capture_output=True, text=True,
        check=False, env={**os.environ, "PYTHONPATH": str(path), "COLUMNS": "80"},
    )  # fmt: skip


class TestThePage:
    """The package of the page, as it is printed there."""

    @pytest.fixture
    def glove(self, tmp_path: Path) -> Path:
        pytest.importorskip("setuptools", reason="builds the package")
        toml, code, made, *_, writer = (
            b.body for b in blocks(PAGE) if b.kind in ("toml", "python")
        )
        folder = tmp_path / "glove"
        folder.mkdir()
        (folder / "pyproject.toml").write_text(toml)
        both = code.replace('"hapfmt_glove",', '"hapfmt_glove", writes=True,')
        (folder / "hapfmt_glove.py").write_text(f"{both}\n\n{writer}")
        built = "from setuptools import setup; setup()"
        subprocess.run(
            [sys.executable, "-c", built, "-q", "egg_info"], cwd=folder, check=True,
            capture_output=True,
        )  # fmt: skip
        exec(f"import json\nimport numpy as np\nimport os\nos.chdir({str(tmp_path)!r})\n{made}", {})
        return folder

    @pytest.fixture(autouse=True)
    def here(self):
        before = Path.cwd()
        yield
        os.chdir(before)

    def test_it_is_thirty_lines(self):
        code, *_, writer = (b.body for b in blocks(PAGE) if b.kind == "python")
        for text, most in ((code, 30), (writer, 11)):
            written = [line for line in text.splitlines() if line and "import" not in line]
            assert len(written) <= most

    def test_inspect_and_encode(self, glove: Path, tmp_path: Path):
        [shown] = (b.body for b in blocks(PAGE) if b.kind == "text")
        for line, output in re.findall(r"^\$ hapfmt (.*)\n((?:[^$].*\n)*)", shown, re.M):
            done = hapfmt_in(tmp_path, *line.split(), path=glove)
            assert done.returncode == 0, done.stderr
            assert shape(output) in ("\n", shape(done.stdout))
        expected = np.arange(3000, dtype=np.int16).reshape(-1, 2).T
        back = hapfmt.read(tmp_path / "grasp.hapf")
        assert back.labels == ["thumb", "index"] and {c.unit for c in back} == {"N"}
        assert np.array_equal([c.counts for c in back], expected) and back.rate == 1000
        # By content alone, by suffix alone, and by name.
        (tmp_path / "grasp.dat").write_bytes((tmp_path / "grasp.glv").read_bytes())
        for name, more in (("grasp.dat", []), ("grasp.dat", ["--input-format", "glove"])):
            done = hapfmt_in(tmp_path, "encode", name, "b.hapf", "-f", *more, path=glove)
            assert done.returncode == 0, done.stderr
            assert np.array_equal([c.counts for c in hapfmt.read(tmp_path / "b.hapf")], expected)
        done = hapfmt_in(tmp_path, "info", "--formats", path=glove)
        assert re.search(r"^glove +\.glv +yes +yes", done.stdout, re.M)
        done = hapfmt_in(tmp_path, "convert", "grasp.glv", "g.npz", path=glove)
        assert done.returncode == 0 and len(hapfmt.read(tmp_path / "g.npz")) == 2
        done = hapfmt_in(tmp_path, "convert", "grasp.hapf", "back.glv", path=glove)
        assert done.returncode == 0 and "units and events are not kept" in done.stderr
        given, found = ((tmp_path / f"{x}.glv").read_bytes() for x in ("grasp", "back"))
        assert found.split(b"\n", 2)[2] == given.split(b"\n", 2)[2]
        hapfmt.write(np.full((2, 9), 33.0), tmp_path / "far.hapf", rate=10, units="N")
        done = hapfmt_in(tmp_path, "convert", "far.hapf", "far.glv", path=glove)
        assert done.returncode == 1 and "up to 32.767 N" in done.stderr
        assert not (tmp_path / "far.glv").exists()

    @pytest.mark.deep
    def test_pip_installs_it(self, glove: Path, tmp_path: Path):
        if not any(map(find_spec, ("setuptools.command.bdist_wheel", "wheel"))):
            pytest.skip("setuptools 70.1 or later, or wheel, makes a package that pip installs")
        pytest.importorskip("pip", reason="installs the package")
        site = tmp_path / "site"
        words = "install -q --no-deps --no-build-isolation --no-index --no-cache-dir --target"
        subprocess.run(
            [sys.executable, "-m", "pip", *words.split(), str(site), str(glove)], check=True,
            capture_output=True, env={**os.environ, "PIP_DISABLE_PIP_VERSION_CHECK": "1"},
        )  # fmt: skip
        assert {"hapfmt_glove.py"} < {path.name for path in site.iterdir()}
        done = hapfmt_in(tmp_path, "info", "grasp.glv", path=site)
        assert done.returncode == 0 and "Glove: 2 channels" in done.stdout
        for words in (
            "encode grasp.glv a.hapf",
            "convert grasp.glv b.hapf",
            "convert grasp.glv c.npz",
        ):
            done = hapfmt_in(tmp_path, *words.split(), path=site)
            assert done.returncode == 0, done.stderr
            back = hapfmt.read(tmp_path / words.split()[-1])
            assert back.labels == ["thumb", "index"] and back.sample_count == 3000
        done = hapfmt_in(tmp_path, "info", "grasp.glv", path=tmp_path)
        assert done.returncode == 2 and "Glove" not in done.stdout

    def test_files_with_faults(self, glove: Path, tmp_path: Path):
        for data in (b"GLOVE1\n", b"GLOVE1\n\xff\n"):
            (tmp_path / "bad.glv").write_bytes(data)
            done = hapfmt_in(tmp_path, "encode", "bad.glv", "b.hapf", path=glove)
            assert done.returncode == 1 and "the plug-in for Glove files failed" in done.stderr
            assert "Traceback" not in done.stderr and not (tmp_path / "b.hapf").exists()


LAB = """
from hapfmt.convert.formats import Format
FORMAT = Format(name={name!r}, title="Lab", suffixes={suffixes!r}, module=__name__)
def read(source, options):
    {body}
"""


def lab(name="lab", suffixes=(".lab",), body="raise ValueError('odd')") -> str:
    return LAB.format(name=name, suffixes=suffixes, body=body)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that packages are installed into."""
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for module in ("hapfmt_lab", "hapfmt_other"):
        sys.modules.pop(module, None)


BROKEN = {
    "import": ("import no_such_library_here", "No module named 'no_such_library_here'"),
    "syntax": ("def", "invalid syntax"),
    "object": ("FORMAT = 'lab'", "is not a hapfmt.convert.formats.Format"),
    "missing": ("", "has no attribute 'FORMAT'"),
    "exit": ("raise SystemExit(3)", "cannot be used: 3"),
    "suffix": (lab(suffixes=".lab"), "suffixes are a tuple"),
    "large": (lab(suffixes=(".LAB",)), "in lower case"),
    "nameless": (lab(name=""), "a name of its own"),
    "ours": (lab(suffixes=(".hapf",)), "belongs to hapfmt"),
    "hapf": (lab(name="hapf"), "a name of its own"),
    "taken": (lab(name="npz"), "another format is called 'npz' too"),
}


class TestFaults:
    @pytest.mark.parametrize("fault", BROKEN)
    def test_a_package_with_a_fault_is_left_out(self, site: Path, fault: str):
        code, message = BROKEN[fault]
        install(site, "hapfmt_lab", code)
        with pytest.warns(DataWarning) as seen:
            found = formats()
        [warning] = [str(w.message) for w in seen if "hapfmt_lab" in str(w.message)]
        assert message in warning and "\n" not in warning
        assert [one for one in found.values() if one in OURS] == list(OURS)
        assert not [one for one in found.values() if one.title == "Lab"]

    def test_a_suffix_that_is_taken(self, site: Path):
        install(site, "hapfmt_lab", lab(suffixes=(".csv", ".lab")))
        with pytest.warns(DataWarning, match="only with --input-format .* lab: .csv is CSV"):
            assert "lab" in formats()
        (site / "a.csv").write_text("t,x\n0,1\n1,2\n")
        assert hapfmt.read(site / "a.csv")[0].samples().tolist() == [1, 2]
        with pytest.raises(ParameterError, match="plug-in for Lab files failed: ValueError: odd"):
            hapfmt.read(site / "a.csv", format="lab")

    def test_a_name_that_two_packages_have(self, site: Path):
        install(site, "hapfmt_lab", lab())
        install(site, "hapfmt_other", lab(suffixes=(".other",)))
        with pytest.warns(DataWarning, match="another format is called 'lab' too"):
            assert "lab" in formats()

    @pytest.mark.parametrize(
        ("body", "message"),
        [
            ("raise KeyError('x')", "KeyError: 'x'"),
            ("return 5", "TypeError: read returned int"),
            ("import no_such_library_here", "ModuleNotFoundError: No module named"),
        ],
    )
    def test_a_reader_that_fails(self, site: Path, body: str, message: str):
        install(site, "hapfmt_lab", lab(body=body))
        (site / "a.lab").write_bytes(b"1")
        with pytest.raises(ParameterError, match=message):
            hapfmt.read(site / "a.lab")

    @pytest.mark.parametrize(
        ("values", "message"),
        [
            ("[np.zeros(3)]", "does not fit its columns"),
            ("[np.zeros(3), np.zeros(2)]", "does not fit its columns"),
            ("[np.zeros(9), np.zeros(9)]", "has more than 3 rows"),
            ("[np.zeros(3), np.zeros(3, 'f4')]", "holds float32, its column says float64"),
            ("[np.zeros(2), np.zeros(2)]", "ended before all of its rows"),
            ("None", "TypeError"),
        ],
    )
    def test_blocks_that_are_not_as_the_table_says(self, site: Path, values: str, message: str):
        body = f"""
    import numpy as np
    from fractions import Fraction
    from hapfmt.convert.tables import Import, ImportBlock, ImportColumn, ImportTable
    columns = ImportColumn("x"), ImportColumn("y")
    table = ImportTable("t", columns, Fraction(10), 3)
    return Import((table,), lambda: iter([ImportBlock(0, 0, {values})]))
"""
        install(site, "hapfmt_lab", lab(body=body))
        (site / "a.lab").write_bytes(b"1")
        with pytest.raises(ParameterError, match=message):
            hapfmt.read(site / "a.lab")

    def test_a_writer(self, site: Path):
        code = lab().replace('title="Lab"', 'title="Lab", writes=True')
        install(site, "hapfmt_lab", f"{code}\ndef write(recording, target, options):\n    1 / 0\n")
        recording = hapfmt.Recording.from_array(np.zeros((1, 5)), 10)
        with pytest.raises(ParameterError, match="Lab files failed: ZeroDivisionError"):
            hapfmt.save(recording, site / "b.lab")
        assert not (site / "b.lab").exists()
        code = f"{code}\ndef write(recording, target, options):\n"
        code += "    target.stream.write(b'%d' % len(recording))\n    return ['no units']\n"
        (site / "hapfmt_lab.py").write_text(code)
        sys.modules.pop("hapfmt_lab")
        formats.cache_clear()
        assert hapfmt.save(recording, site / "b.lab") == ("no units",)
        assert (site / "b.lab").read_bytes() == b"1"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"magic": ((0, "PK"),)}, "magic"),
        ({"magic": ((510, b"PKK"),)}, "within the first 512"),
        ({"options": frozenset({"slect"})}, "did you mean 'select'"),
        ({"title": ""}, "a title"),
    ],
)
def test_a_description_with_a_fault(given: dict, message: str):
    whole = {"name": "lab", "title": "Lab", "suffixes": (".lab",), "module": "lab"}
    Format(**whole)
    with pytest.raises(ParameterError, match=message):
        Format(**(whole | given))


NO_METADATA = (
    "import sys, importlib.metadata as m\n"
    "def none(*_, **__): raise m.PackageNotFoundError('hapfmt')\n"
    "m.distribution = m.version = m.metadata = none\n"
    "m.entry_points = lambda **_: m.EntryPoints()\n"
    "import hapfmt\n"
    "from hapfmt.convert.formats import OURS, formats\n"
    "assert hapfmt.__file__.startswith(sys.argv[1]), hapfmt.__file__\n"
    "assert list(formats().values()) == list(OURS)\n"
    "assert hapfmt.read('a.csv')[0].samples().tolist() == [1, 2]\n"
    "hapfmt.save(hapfmt.read('a.csv'), 'b.npz')\n"
    "hapfmt.write(hapfmt.read('b.npz'), 'c.hapf')\n"
    "print(len(hapfmt.read('c.hapf')[0].samples()))\n"
)


@pytest.mark.parametrize("kind", ["zip", *deep(["folder"])])
def test_our_formats_need_no_metadata(tmp_path: Path, kind: str):
    """A source tree that was never installed, or a zip file of it."""
    tree = tmp_path / "tree"
    ignored = shutil.ignore_patterns("__pycache__", "*.so", "*.c", "*.h", "page", "decoder")
    shutil.copytree(ROOT / "hapfmt", tree / "hapfmt", ignore=ignored)
    if kind == "zip":
        shutil.make_archive(str(tree), "zip", tree)
        shutil.rmtree(tree)
        tree = tree.with_suffix(".zip")
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,2\n")
    done = subprocess.run(
        [sys.executable, "-c", NO_METADATA, str(tree)], cwd=tmp_path, capture_output=True,
        text=True, check=False, env={**os.environ, "PYTHONPATH": str(tree)},
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "2\n"), done.stderr


def test_plug_ins_are_not_looked_for_where_none_is_needed(tmp_path: Path):
    hapfmt.write(np.zeros(9), tmp_path / "a.hapf", rate=10)
    program = (
        "import sys\nimport importlib.metadata as m\n"
        "def no(**_): raise AssertionError('looked for plug-ins')\n"
        "m.entry_points = no\n"
        "import hapfmt\nfrom hapfmt.cli import main\n"
        "hapfmt.read('a.hapf')\nsys.argv = ['hapfmt', 'info', 'a.hapf']\nmain()"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr

"""What is published: sdist, wheel, metadata, and the files by which other programs know hapf."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from spec import ROOT

import hapfmt

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
NOT_COPIED = (
    ".git",
    ".venv",
    "build",
    "dist",
    "*.egg-info",
    "__pycache__",
    ".*_cache",
    ".hypothesis",
)
ADDRESS = "https://repository.example/hapfmt"


def run(*words: str | Path, cwd: Path, **environment: str) -> str:
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "HAPFMT_"))}
    done = subprocess.run(
        words, cwd=cwd, capture_output=True, text=True, check=False, env={**kept, **environment}
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def published() -> list[str]:
    """Files under version control; in an sdist, the files that are there."""
    if shutil.which("git") and (ROOT / ".git").exists():
        return run("git", "ls-files", cwd=ROOT).splitlines()
    pytest.skip("no git here: an sdist")


@pytest.fixture(scope="module")
def sdist(tmp_path_factory) -> Path:
    pytest.importorskip("build")
    room = tmp_path_factory.mktemp("sdist")
    # In a copy: setuptools writes beside the sources, and other tests may run at the same time.
    shutil.copytree(ROOT, room / "copy", ignore=shutil.ignore_patterns(*NOT_COPIED))
    words = ("-m", "build", "--sdist", "--no-isolation", "--outdir", room, room / "copy")
    run(sys.executable, *words, cwd=room, HAPFMT_REPOSITORY=ADDRESS + "/")
    (found,) = room.glob("*.tar.gz")
    return found


@pytest.fixture(scope="module")
def unpacked(sdist, tmp_path_factory) -> Path:
    room = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(sdist) as archive:
        archive.extractall(room, filter="data")
    (folder,) = room.iterdir()
    return folder


@pytest.fixture(scope="module")
def wheel(unpacked, tmp_path_factory) -> Path:
    """Of the sdist, not of the clone."""
    room = tmp_path_factory.mktemp("wheel")
    words = ("-m", "build", "--wheel", "--no-isolation", "--outdir", room, unpacked)
    run(sys.executable, *words, cwd=room)
    (found,) = room.glob("*.whl")
    return found


class TestMetadata:
    def test_citation(self):
        """The version and the licence are those of the package."""
        text = (ROOT / "CITATION.cff").read_text("utf-8")
        assert re.search(r"^version: (.*)$", text, re.M)[1] == hapfmt.__version__
        assert re.search(r"^license: (.*)$", text, re.M)[1] == PROJECT["license"]
        keywords = re.search(r"^keywords: \[(.*)\]$", text, re.M)[1].split(", ")
        assert keywords == PROJECT["keywords"]

    def test_citation_keeps_its_schema(self):
        pytest.importorskip("check_jsonschema")
        words = ("-m", "check_jsonschema", "--builtin-schema", "vendor.citation-file-format")
        run(sys.executable, *words, "CITATION.cff", cwd=ROOT)

    def test_the_conda_recipe_has_the_same_dependencies(self):
        text = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text("utf-8")
        assert f'version: "{hapfmt.__version__}"' in text
        needed = text.split("  run:\n")[1].split("\n\n")[0]
        names = [line.strip().removeprefix("- ") for line in needed.splitlines()]
        wanted = [f"python{PROJECT['requires-python']}", *PROJECT["dependencies"]]
        assert [name.replace(" ", "") for name in names] == wanted
        build = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["build-system"]
        host = text.split("  host:\n")[1].split("  run:\n")[0]
        assert set(build["requires"]) <= {line.replace(" ", "")[1:] for line in host.splitlines()}

    @pytest.mark.deep
    def test_the_conda_recipe_renders(self):
        """For each version of Python that is given."""
        rattler = pytest.importorskip("rattler_build")
        recipe = rattler.Stage0Recipe.from_file(str(ROOT / "packaging" / "conda" / "recipe.yaml"))
        variants = "c_compiler: [gcc]\nc_stdlib: [sysroot]\npython: ['3.11.*', '3.14.*']\n"
        found = recipe.render(rattler.VariantConfig.from_yaml(variants))
        assert len(found) == 2
        for each in found:
            about = each.recipe.to_dict()
            assert about["package"]["version"] == hapfmt.__version__

    def test_the_workflow_keeps_its_schema(self):
        pytest.importorskip("check_jsonschema")
        words = ("-m", "check_jsonschema", "--builtin-schema", "vendor.github-workflows")
        run(sys.executable, *words, ".github/workflows/packages.yml", cwd=ROOT)

    def test_classifiers(self):
        known = pytest.importorskip("trove_classifiers").classifiers
        assert set(PROJECT["classifiers"]) <= known
        assert PROJECT["classifiers"] == sorted(set(PROJECT["classifiers"]))


@pytest.mark.deep
class TestSdist:
    def test_it_holds_all_that_is_under_version_control(self, sdist):
        with tarfile.open(sdist) as archive:
            found = {name.partition("/")[2] for name in archive.getnames()}
        wanted = set(published())
        assert wanted <= found
        made = re.compile(r"hapfmt\.egg-info(/|$)|PKG-INFO$|setup\.cfg$|$")
        files = {name for name in found if not (ROOT / name).is_dir()}
        assert not {name for name in files - wanted if not made.match(name)}

    def test_addresses_are_those_of_the_repository_that_publishes(self, unpacked, wheel):
        lines = (unpacked / "PKG-INFO").read_text("utf-8").splitlines()
        urls = [line for line in lines if line.startswith("Project-URL: ")]
        assert f"Project-URL: Source, {ADDRESS}" in urls
        pages = [line.split(f"{ADDRESS}/blob/main/")[1] for line in urls if "/blob/" in line]
        assert pages and all((ROOT / page).is_file() for page in pages)
        with zipfile.ZipFile(wheel) as archive:
            (name,) = [name for name in archive.namelist() if name.endswith("/METADATA")]
            metadata = archive.read(name).decode()
        assert [line for line in metadata.splitlines() if line.startswith("Project-URL")] == urls


@pytest.mark.deep
class TestWheel:
    def test_one_wheel_for_all_versions_of_cpython(self, wheel):
        from hapfmt.kernels import compiled

        tag = wheel.stem.split("-", 2)[2]
        assert tag.startswith("cp311-abi3-"), tag
        with zipfile.ZipFile(wheel) as archive:
            loops = [n for n in archive.namelist() if re.search(r"_kernels\..*(so|pyd)$", n)]
        assert len(loops) == (1 if compiled else 0)

    def test_it_holds_the_package_and_its_data_alone(self, wheel):
        with zipfile.ZipFile(wheel) as archive:
            names = {name for name in archive.namelist() if ".dist-info/" not in name}
        assert all(name.startswith("hapfmt/") for name in names)
        left_out = {
            path.relative_to(ROOT).as_posix()
            for path in (ROOT / "hapfmt").rglob("*")
            if path.is_file() and "__pycache__" not in path.parts and path.suffix not in (".so", ".pyd")
        } - names  # fmt: skip
        assert {Path(name).suffix for name in left_out} == {".c", ".h"}
        assert {Path(name).parent.as_posix() for name in left_out} == {"hapfmt/kernels"}

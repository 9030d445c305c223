"""The page of the format goes into the distribution too: generators read its tables."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

HERE = Path(__file__).resolve().parent
PAGES = ("SPEC.md", "docs/spec/*.md")


def copy_pages(to: Path) -> None:
    home = HERE if (HERE / "SPEC.md").exists() else HERE.parent
    for pattern in PAGES:
        for page in home.glob(pattern):
            target = to / page.relative_to(home)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(page, target)


class Build(build_py):
    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            copy_pages(Path(self.build_lib, "hapf_conformance"))


class Source(sdist):
    def make_release_tree(self, base_dir, files) -> None:
        super().make_release_tree(base_dir, files)
        copy_pages(Path(base_dir))


setup(cmdclass={"build_py": Build, "sdist": Source})

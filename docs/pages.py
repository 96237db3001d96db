"""What MkDocs does not find in docs/: README, CHANGELOG, CONTRIBUTING and the pages of the API.

A page of the API for every package and public module, made from its docstrings. Links to source
files lead to their page there; links to other files of the repository become plain text.
"""

from __future__ import annotations

import posixpath
import re
from importlib import import_module
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
PACKAGES = ("synthgen", "totalediting", "assets_procedural")
MOVED = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
}
"""Files of the repository that are pages of the site."""
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """The pages' order: overview, what docs/ has, how to take part, the API as a tree."""
    pages = sorted(path.name for path in (ROOT / "docs").glob("*.md"))
    api: list[object] = ["api/index.md", *(tree(ROOT / package) for package in PACKAGES)]
    config.nav = ["index.md", *pages, "contributing.md", "changelog.md", {"API": api}]
    return config


def tree(folder: Path) -> dict[str, list]:
    """A package and what lies in it, as MkDocs' navigation has it."""
    inside: list[object] = [page_of(folder / "__init__.py")]
    inside += [tree(package.parent) for package in sorted(folder.glob("*/__init__.py"))]
    inside += [
        {source.stem: page_of(source)}
        for source in sorted(folder.glob("*.py"))
        if not source.stem.startswith("_")
    ]
    return {folder.name: inside}


def page_of(source: Path) -> str:
    """The page of a source file."""
    path = source.relative_to(ROOT)
    if source.name == "__init__.py":
        return f"api/{path.parent}/index.md"
    return f"api/{path.with_suffix('.md')}"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    for source, page in MOVED.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=text))
    files.append(File.generated(config, "api/index.md", content=promised()))
    for package in PACKAGES:
        for source in (ROOT / package).rglob("*.py"):
            module = ".".join(source.relative_to(ROOT).with_suffix("").parts)
            module = module.removesuffix(".__init__")
            if not source.stem.startswith("_") or source.name == "__init__.py":
                text = f"# {module.split('.')[-1]}\n\n::: {module}\n"
                files.append(File.generated(config, page_of(source), content=text))
    return files


def promised() -> str:
    """The page of what a user may rely on: the `__all__` of each package."""
    text = "# API\n\nWhat can be relied on; all else may move between releases.\n"
    for package in PACKAGES:
        names = getattr(import_module(package), "__all__", [])
        public = [name for name in names if not name.startswith("_")]
        if public:
            text += f"\n## {package}\n"
            text += "".join(f"\n::: {package}.{name}\n" for name in sorted(public))
    return text


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    here = page.file.src_uri
    if here.startswith("api/"):
        return markdown
    written = {page: source for source, page in MOVED.items()}.get(here, f"docs/{here}")

    def lead(match: re.Match[str]) -> str:
        image, text, target, anchor = match.groups()
        if "://" in target:
            return match[0]
        repository = posixpath.normpath(posixpath.join(posixpath.dirname(written), target))
        path = ROOT / repository
        if repository.startswith("docs/"):
            site = repository.removeprefix("docs/")
        elif repository in MOVED:
            site = MOVED[repository]
        elif path.suffix == ".py" and files.get_file_from_path(page_of(path)):
            site = page_of(path)
        else:
            return text
        relative = posixpath.relpath(site, posixpath.dirname(here) or ".")
        return f"{image}[{text}]({relative}{anchor or ''})"

    return LINK.sub(lead, markdown)

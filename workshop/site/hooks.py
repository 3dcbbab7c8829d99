"""The hook of mkdocs: pages from outside of ``docs/``, generated pages, links and equations.

The pages of ``docs/`` are written for a plain checkout, where a link such as ``../examples/car/``
leads to a folder.  On the site the same files have other addresses: those below ``docs/`` lie at
the top, all others keep their path in the repository.
"""

from __future__ import annotations

import html
import os
import re
import subprocess
import sys
from pathlib import Path, PurePosixPath
from typing import Any

import language_model_files
import latex2mathml.converter
import playground_links
import reference_commands
import reference_diagnostics
import reference_documents
import reference_modules
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
OUTSIDE_PAGES = ("README.md", "CHANGELOG.md", "modules/README.md", "examples/*/README.md")
LINK = re.compile(r"(!?\[(?:`[^`\n]*`|[^\]`])*\]\()([^)#\s]+)([^)]*\))")
CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.M | re.S)
LINK_OR_CODE = re.compile(f"{LINK.pattern}|{CODE.pattern}", re.M | re.S)


def address_on_site(path: PurePosixPath) -> PurePosixPath:
    """Returns the address of a file, given by its path in the repository."""
    return path.relative_to("docs") if path.parts[:1] == ("docs",) else path


def path_in_repository(address: str) -> PurePosixPath:
    """Returns the path in the repository of a page, given by its address on the site."""
    inside = PurePosixPath("docs") / address
    return inside if (ROOT / inside).is_file() else PurePosixPath(address)


def target_of(page: PurePosixPath, link: str) -> PurePosixPath | None:
    """Returns the file in the repository that a link leads to; ``None`` for any other link."""
    if "://" in link or link.startswith(("mailto:", "#")):
        return None
    path = PurePosixPath(os.path.normpath(page.parent / link))
    if path.parts[:1] == ("..",) or not (ROOT / path).exists():
        return None
    if (ROOT / path).is_dir():
        return path / "README.md"
    return path


def links_of(text: str) -> list[str]:
    return [match[2] for match in LINK_OR_CODE.finditer(text) if match[2]]


def on_files(files: Files, config: Any) -> Files:
    """Adds the pages outside of ``docs/`` and the files that pages show or link to."""
    waiting = [path.relative_to(ROOT) for path in sorted(ROOT.glob("docs/**/*.md"))]
    for pattern in OUTSIDE_PAGES:
        waiting += [path.relative_to(ROOT) for path in sorted(ROOT.glob(pattern))]
    pages = [PurePosixPath(path.as_posix()) for path in waiting]
    outside = {page for page in pages if page.parts[0] != "docs"} - {PurePosixPath("README.md")}
    for page in pages:
        for link in links_of((ROOT / page).read_text(encoding="utf-8")):
            target = target_of(page, link)
            if target is not None and target.parts[0] != "docs" and (ROOT / target).is_file():
                outside.add(target)
    outside.discard(PurePosixPath("README.md"))  # the home page is docs/index.md
    for path in sorted(outside):
        files.append(File.generated(config, str(path), abs_src_path=str(ROOT / path)))
    generated = {
        "reference/commands.md": reference_commands.page(),
        "diagnostics/index.md": reference_diagnostics.page(),
        **reference_documents.pages(),
        **reference_modules.pages(),
    }
    for address, content in generated.items():
        key = "abs_src_path" if isinstance(content, Path) else "content"
        files.append(File.generated(config, address, **{key: str(content)}))
    return files


has_playground = False

PAGES_OF_NAVIGATION: dict[str, language_model_files.PageText] = {}
"""Pages by their address, in the order of the navigation."""


def on_nav(nav: Any, config: Any, files: Files) -> Any:
    """Remembers the pages of the navigation with their sections."""
    PAGES_OF_NAVIGATION.clear()
    for page in nav.pages:
        section = page.ancestors[-1].title if page.ancestors else "Start"
        address = page.file.src_uri
        PAGES_OF_NAVIGATION[address] = language_model_files.PageText(section, "", address, "")
    return nav


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Gives links to files their addresses on the site."""
    text = _with_links_of_the_site(markdown, page)
    if known := PAGES_OF_NAVIGATION.get(page.file.src_uri):
        PAGES_OF_NAVIGATION[page.file.src_uri] = known._replace(title=page.title, text=text)
    if has_playground:
        start = PurePosixPath(page.file.src_uri).parent
        playground = os.path.relpath("playground/index.html", start)
        text = playground_links.with_links(text, playground)
        if start.parts[:1] == ("examples",):
            text = playground_links.with_example_link(text, ROOT / start, playground)
    else:
        text = playground_links.without_links(text)
    return text


def _with_links_of_the_site(markdown: str, page: Any) -> str:
    source = path_in_repository(page.file.src_uri)
    if not (ROOT / source).is_file():
        return markdown

    def on_site(match: re.Match[str]) -> str:
        if not match[2]:
            # GitHub wants a backslash before a bar in code in a table; here it would be shown.
            return match[0] if match[0].startswith("```") else match[0].replace("\\|", "|")
        target = target_of(source, match[2])
        if target is None:
            return match[0]
        if target == PurePosixPath("README.md"):
            target = PurePosixPath("docs/index.md")
        start = PurePosixPath(page.file.src_uri).parent
        return match[1] + os.path.relpath(address_on_site(target), start) + match[3]

    return LINK_OR_CODE.sub(on_site, markdown)


EQUATION = re.compile(
    r'<(span|div) class="arithmatex">\s*(?:\\\(|\\\[)(.*?)(?:\\\)|\\\])\s*</\1>', re.S
)


INLINE_CODE = re.compile(r"<code>[^<]*--[^<]*</code>")


def on_page_content(content: str, page: Any, config: Any, files: Files) -> str:
    """Replaces equations in TeX by MathML, which browsers show without a script.

    The names of options are not broken at their hyphens.
    """
    content = INLINE_CODE.sub(
        lambda code: re.sub(r"\[?--[\w-]+", r'<span class="option">\g<0></span>', code[0]), content
    )

    def in_mathml(match: re.Match[str]) -> str:
        display = "block" if match[1] == "div" else "inline"
        mathml = latex2mathml.converter.convert(html.unescape(match[2].strip()), display=display)
        if display == "block":
            return f'<div class="equation" tabindex="0">{mathml}</div>'
        return mathml

    # A header without a text is an empty cell to somebody who listens to the table.
    return EQUATION.sub(in_mathml, content).replace("<th></th>", "<td></td>")


def on_post_page(output: str, page: Any, config: Any) -> str:
    return named_search(output)


def on_post_template(output: str, template_name: str, config: Any) -> str:
    return named_search(output)


def named_search(output: str) -> str:
    """Gives the search box of the theme a name."""
    return output.replace('role="dialog">', 'role="dialog" aria-label="Search">')


def on_startup(command: str, dirty: bool) -> None:
    """Leaves the playground out of a site that is built again after each change of a page."""
    global has_playground
    has_playground = command == "build" and playground_links.can_build()
    if command == "build" and not has_playground:
        print("The playground is left out of the site: its build needs npm.", file=sys.stderr)


def on_post_build(config: Any) -> None:
    """Builds the playground, and writes the files for language models and the index of the search.

    A page that is opened as a file can load no JSON: the index is written as a script too.
    """
    if has_playground:
        command = [sys.executable, str(ROOT / "playground" / "build.py")]
        subprocess.run([*command, str(Path(config.site_dir, "playground"))], check=True)
    folder, pages = Path(config.site_dir), PAGES_OF_NAVIGATION.values()
    language_model_files.write_files(folder, config.site_name, config.site_description, pages)
    folder = Path(config.site_dir, "search")
    index = (folder / "search_index.json").read_text(encoding="utf-8")
    (folder / "search_index.js").write_text(f"var __index = {index}", encoding="utf-8")

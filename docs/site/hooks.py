"""The parts of the site that no Markdown file holds: commands, replays, formulas as MathML."""

import html
import importlib
import re
from pathlib import Path
from xml.etree.ElementTree import Element, tostring

from latex2mathml.converter import convert_to_element
from mkdocs.structure.files import File, Files

from softdyn.commands.__main__ import COMMANDS, spelt

# as pymdownx.arithmatex marks them
NAMES = re.compile(r"^\*Names of `([\w.]+)`:\* (.+)$", re.M)  # in api.md
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.S)
# code; in it a tag, or an option or a number with a hyphen, where a wrapped line must not break
CODE = re.compile(r"<pre.*?</pre>|<code>.*?</code>", re.S)
HYPHENED = re.compile(r"(<[^>]*>)|(?<![\w-])(--?\w[\w.-]*|[\d.]+e-\d+)")
TAG = re.compile(r"\\tag\{(\w+)\}")
# under their operator in a displayed formula
LIMITS = {"min", "max", "\u2211"}  # Σ
# `python -m tests.proof gallery` writes them
REPLAYS = Path(__file__).parents[2] / "build" / "gallery"
STILL = re.compile(r'<img [^>]*src="gallery/(\w+)\.png"[^>]*>')
# a click puts the replay in the picture's place; without scripts it opens the page
PLAY = "this.outerHTML='<iframe class=replay src='+this.href+'></iframe>';return false"


def on_files(files: Files, config) -> Files:
    """Add the replays of the gallery.

    Raises
    ------
    FileNotFoundError
        A replay is not made yet.
    """
    for still in sorted(Path(config["docs_dir"]).glob("gallery/*.png")):
        page = REPLAYS / f"{still.stem}.html"
        if not page.is_file():
            raise FileNotFoundError(f"{page}: `python -m tests.proof gallery` makes it")
        files.append(File.generated(config, f"gallery/{page.name}", abs_src_path=str(page)))
    return files


def on_page_markdown(markdown: str, page, **_) -> str:
    """Add each command's help to commands.md, and to api.md the docstrings of its names."""
    if page.file.src_uri == "commands.md":
        return markdown + commands()
    if page.file.src_uri == "api.md":
        return NAMES.sub(lambda found: found[0] + "\n\n" + docstrings(found[1], found[2]), markdown)
    return markdown


def docstrings(module: str, names: str) -> str:
    """The directive that shows the docstrings of names in backticks."""
    members = ", ".join(re.findall(r"`(\w+)`", names))
    return f"::: {module}\n    options:\n      members: [{members}]\n"


def on_page_content(content: str, **_) -> str:
    """Replace formulas by MathML, which browsers draw without a script; let stills play.

    Options in code are kept in one piece.
    """
    content = STILL.sub(
        r'<a class="still" href="gallery/\1.html" onclick="' + PLAY + r'">\g<0></a>', content
    )
    content = CODE.sub(lambda code: HYPHENED.sub(_whole, code[0]), content)
    return FORMULA.sub(lambda found: formula(html.unescape(found[2]), found[1] == "div"), content)


def _whole(found: re.Match[str]) -> str:
    return found[1] or f'<span class="whole">{found[2]}</span>'


def commands() -> str:
    """The commands' help as Markdown."""
    lines = [""]
    for purpose, names in COMMANDS.items():
        lines += [f"## {purpose.capitalize()}", ""]
        for name in names:
            parser = importlib.import_module(f"softdyn.commands.{name}").parser
            parser.prog = f"softdyn {spelt(name)}"
            lines += [f"### {spelt(name)}", "", "```text", parser.format_help().rstrip(), "```", ""]
    return "\n".join(lines)


def formula(tex: str, displayed: bool) -> str:
    """MathML of a formula in LaTeX; a displayed one with the number of its \\tag beside it.

    Raises
    ------
    ValueError
        LaTeX that the converter does not know.
    """
    tags, tex = TAG.findall(tex), TAG.sub("", tex).strip()
    # the converter knows align*, which is drawn alike
    tex = tex.replace("{aligned}", "{align*}")
    math = convert_to_element(tex, display="block" if displayed else "inline")
    for element in math.iter():
        _mend(element, displayed)
    unknown = [x.text for x in math.iter() if x.text and re.search(r"[\\&]", x.text)]
    if unknown:
        raise ValueError(f"formula {tex!r}: expected known LaTeX, got {unknown}")
    text = tostring(math, encoding="unicode")
    if not displayed:
        return text
    number = "".join(f"<span>({tag})</span>" for tag in tags)
    return f'<div class="formula">{text}{number}</div>'


def _mend(element: Element, displayed: bool) -> None:
    """Decode its text; put limits of a displayed operator below it."""
    element.text = html.unescape(element.text or "") or None
    if displayed and element.tag == "msub" and element[0].text in LIMITS:
        element.tag = "munder"

"""What the site needs beside Markdown: formulas as MathML, docstrings as Markdown.

Everything is made when the site is built, so that its pages load nothing and need no script for
their formulas.
"""

from __future__ import annotations

import html
import re
import sys

import griffe
from latex2mathml.converter import convert

PRIMES = (
    ("<mrow><mi>&#x02032;</mi><mi>&#x02032;</mi></mrow>", "<mo>&#x02033;</mo>"),
    ("<mi>&#x02032;</mi>", "<mo>&#x02032;</mo>"),
)
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def on_startup(**_: object) -> None:
    """Name the program in usage lines: cyclopts takes the running one, here the site builder."""
    sys.argv[0] = "quasiform"


def on_page_content(content: str, **_: object) -> str:
    """Turn TeX into MathML, which browsers draw by themselves."""

    def mathml(found: re.Match[str]) -> str:
        display = "block" if found[1] == "div" else "inline"
        tex = html.unescape(found[2]).strip().replace("''", r"^{\prime\prime}")
        drawn = convert(tex, display=display)
        if "<mi>&amp;</mi>" in drawn or "<mo>&amp;</mo>" in drawn or "\\" in drawn:
            raise ValueError(f"the converter does not know all of {tex}")
        for primes, as_one in PRIMES:  # one sign each, as high as fonts draw it
            drawn = drawn.replace(primes, as_one)
        return drawn

    return FORMULA.sub(mathml, content)


def on_page_markdown(markdown: str, **_: object) -> str:
    """Take out the builder, which cyclopts writes into usages under `python -m mkdocs`."""
    return re.sub(r"^(quasiform \S+) -m mkdocs", r"\1", markdown, flags=re.MULTILINE)


class Markdown(griffe.Extension):
    """Docstrings are numpydoc; what of their markup is not Markdown is turned into it."""

    def on_instance(self, *, obj: griffe.Object, **_: object) -> None:
        """Called for every object with its docstring as written."""
        if obj.docstring:
            text = obj.docstring.value
            text = re.sub(r"::$", ":", text, flags=re.MULTILINE)
            text = re.sub(r"\[(\d)\]_", r"[\1]", text)
            obj.docstring.value = re.sub(r"^\.\. \[(\d)\] ", r"\n[\1] ", text, flags=re.MULTILINE)

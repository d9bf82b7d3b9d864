"""The report as one HTML file: the verdict, then every case with numbers, pictures and sheets.

Styles, scripts, pictures and plotly are inside the file; nothing is loaded from anywhere.
"""

from __future__ import annotations

import base64
from collections import Counter
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from markdown_it import MarkdownIt

from .bands import (
    AWAITED,
    HELD,
    LEFT_OUT,
    LIMITATION,
    MISSED,
    MISSING,
    SHOWN,
    STANDINGS,
    Case,
    Row,
)
from .report_text import band, duration, mostly_left_out, quantity, verdict

if TYPE_CHECKING:
    from .report import About

FOLDER = Path(__file__).parent
SIGNS = {  # sign, class and word of a row's state
    HELD: ("✓", "held", "held"),
    MISSED: ("✗", "missed", "missed"),
    MISSING: ("✗", "missing", "no value"),
    LIMITATION: ("◆", "limitation", "limitation"),
    AWAITED: ("○", "awaited", "needs data"),
    SHOWN: ("·", "shown", "shown only"),
    LEFT_OUT: ("–", "left", "left out"),
}
COUNTED = {  # missing values count as missed
    HELD: "held",
    MISSED: "missed",
    LIMITATION: "limitations",
    AWAITED: "needs data",
    SHOWN: "shown only",
}
MEANINGS = {
    "measured": "an experiment, published; the only rows that are agreement with one",
    "stated": "said by the paper that this package follows",
    "exact": "a closed form, or an equation solved to all digits",
    "peer": "another code on the same problem",
    "prototype": "an earlier calculation by this method",
    "inferred": "follows from what is stated, with an assumption",
    "assumed": "a choice where nothing is stated",
    "own": "this package's own bound: consistency, no outside reference",
}
STUDIES = {  # pictures made by commands of their own
    "Speed and accuracy": (
        "speed",
        ("chart_*.svg", "chart_*.png"),
        "python -m validation.speed --out validation/speed",
        "Error against work for sizes, increments and strategies, with the Pareto front.",
    ),
    "Stability map": (
        "stability",
        ("map*.svg", "map*.png"),
        "python -m validation.stability",
        "Scenes against settings: the travel reached, rescues and certificate of each.",
    ),
}
TYPES = {".png": "image/png", ".svg": "image/svg+xml"}
NO_VIEW = "To turn it in 3D, install plotly: <code>pip install 'quasiform[report]'</code>."
HELP = "Drag to turn, scroll to zoom, point at a triangle (or click it) for its shear angle."


def page(about: About, done: list[Case], waiting: list[str]) -> str:
    """The whole file."""
    studies = "".join(
        f'<section id="{study[0]}"><h2>{title}</h2>{_study(*study)}</section>'
        for title, study in STUDIES.items()
    )
    sheets = [sheet for case in done for sheet in case.sheets if sheet[2]]
    scripts = ""
    if sheets:
        from plotly.offline import get_plotlyjs

        own = (FOLDER / "report.js").read_text(encoding="utf-8")
        scripts = f"<script>{get_plotlyjs()}</script>\n<script>{own}</script>"
    sentence = verdict(done, waiting)
    mood = "open" if waiting or not done else "" if all(case.held for case in done) else "bad"
    suite = "quick suite" if about.quick else "full suite"
    left_out = ""
    if about.left_out:
        names = ", ".join(f"<code>{escape(name)}</code>" for name in about.left_out)
        left_out = f'<p class="quiet">Not part of this run: {names}.</p>'
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>quasiform: validation report</title>
<style>
{(FOLDER / "report.css").read_text(encoding="utf-8")}</style>
</head>
<body>
{_contents(done, waiting)}
<main>
<header id="top">
<h1>Validation report</h1>
<p class="quiet">quasiform {escape(about.versions["quasiform"])} · {suite} ·
{escape(_day(about.date))} · {escape(about.machine["processor"])},
{about.machine["cores"]} cores</p>
<p class="verdict {mood}">{escape(sentence)}</p>
<p>Quasiform predicts how a dry biaxial fabric shears when it is stretched or formed. This report
sets what it computes beside references: exact solutions, other codes, statements of the paper it
follows, and measurements. Each reference says what it is worth (its
<a href="#reading">standing</a>), and each band was fixed before the run.</p>
</header>
<section id="verdict"><h2>Verdict by case</h2>
{_verdict_table(done, waiting)}
{left_out}
{_standings_table(done)}
</section>
<section id="attention"><h2>What a reader should know first</h2>
{_attention(done)}</section>
<section id="reading"><h2>How to read the tables</h2>
{_legend()}</section>
{"".join(map(_case, done))}
{studies}
<section id="made"><h2>Versions and machine</h2>
{_made(about, done)}</section>
</main>
{_figures(done)}
{scripts}
</body>
</html>
"""


def _contents(done: list[Case], waiting: list[str]) -> str:
    """The contents page, which stays beside the text on wide screens."""
    front = {"verdict": "Verdict by case", "attention": "What to know first"}
    front["reading"] = "How to read the tables"
    back = {folder: title for title, (folder, *_) in STUDIES.items()}
    back["made"] = "Versions and machine"
    cases = ""
    for case in done:
        sign, kind, _ = SIGNS[_state(case)]
        cases += (
            f'<li class="{kind}"><span class="mark state">{sign}</span>'
            f'<a href="#case-{case.name}">{_title(case.name)}</a></li>'
        )
    cases += "".join(
        f'<li><span class="mark">…</span>{escape(name)} (not run yet)</li>' for name in waiting
    )

    def entries(parts: dict[str, str]) -> str:
        return "".join(f'<li><a href="#{at}">{title}</a></li>' for at, title in parts.items())

    return (
        f'<nav aria-label="Contents"><h2>Contents</h2><ol>{entries(front)}</ol>'
        f"<h2>Cases</h2><ol>{cases}</ol><h2>Also</h2><ol>{entries(back)}</ol></nav>"
    )


def _verdict_table(done: list[Case], waiting: list[str]) -> str:
    total = sum((case.counts for case in done), Counter())
    columns, words = [*COUNTED], [*COUNTED.values()]
    if total[LEFT_OUT]:
        columns, words = [*columns, LEFT_OUT], [*words, LEFT_OUT]
    head = "".join(f'<th class="n">{word}</th>' for word in ["rows", *words, "time"])
    lines = []
    for case in done:
        counts = case.counts + Counter({MISSED: case.counts[MISSING]})
        sign, kind, _ = SIGNS[_state(case)]
        reason = "; ".join(filter(None, (case.problem, mostly_left_out(case))))
        told = f'<span class="reason">{escape(reason)}</span>' if reason else ""
        lines.append(
            f'<tr class="{kind}"><td><span class="state">{sign}</span> '
            f'<a href="#case-{case.name}">{_title(case.name)}</a>{told}</td>'
            f"{_counted(len(case.rows))}{''.join(_counted(counts[name]) for name in columns)}"
            f'<td class="n">{duration(case.seconds)}</td>'
            f'<td class="n">{escape(_clock(case.date))}</td></tr>'
        )
    total[MISSED] += total[MISSING]
    rows = sum(len(case.rows) for case in done)
    lines += [
        f'<tr><td>… {escape(name)}</td><td colspan="{len(columns) + 3}">not run yet</td></tr>'
        for name in waiting
    ]
    lines.append(
        f'<tr class="total"><td>All</td>{_counted(rows)}'
        f"{''.join(_counted(total[name]) for name in columns)}"
        f'<td class="n">{duration(sum(case.seconds for case in done))}</td><td></td></tr>'
    )
    return _table(f"<th>case</th>{head}<th>begun</th>", lines)


def _state(case: Case) -> str:
    """State of a case as a whole, as that of a row: held only where most of it was computed."""
    if not case.held:
        return MISSED
    return LEFT_OUT if mostly_left_out(case) else HELD


def _standings_table(done: list[Case]) -> str:
    """Rows by what their references are worth."""
    rows = [row for case in done for row in case.rows]
    lines = []
    for standing in STANDINGS:
        states = Counter(row.state for row in rows if row.reference.standing == standing)
        if states:
            number = states.total()
            states[MISSED] += states[MISSING]
            counted = [number, *(states[state] for state in COUNTED)]
            lines.append(
                f"<tr><td>{standing}</td>{''.join(map(_counted, counted))}"
                f'<td class="source">{MEANINGS[standing]}</td></tr>'
            )
    words = "".join(f'<th class="n">{word}</th>' for word in ["rows", *COUNTED.values()])
    head = f"<th>standing</th>{words}"
    return f"<h3>By the standing of the reference</h3>{_table(f'{head}<th></th>', lines)}"


def _counted(number: int) -> str:
    return f'<td class="n{"" if number else " zero"}">{number}</td>'


def _attention(done: list[Case]) -> str:
    """What is missed, limited or waiting, gathered from all cases."""
    parts = [
        f'<p class="problem"><b><a href="#case-{case.name}">{_title(case.name)}</a></b>: '
        f"{escape(case.problem)}</p>"
        for case in done
        if case.problem
    ]
    for states, title, empty in (
        ((MISSED, MISSING), "Bands missed and values missing", "None."),
        ((LIMITATION,), "Known limitations", "None."),
        ((AWAITED,), "Rows that need measured data", "None."),
    ):
        found = [(case, row) for case in done for row in case.rows if row.state in states]
        body = _rows(found) if found else f"<p>{empty}</p>"
        if found and states == (AWAITED,):  # many, and the same words in most of them
            words = f"{len(found)} rows wait for numbers that are not published; nothing is judged"
            body = f"<details><summary>{words}</summary>{body}</details>"
        parts.append(f"<h3>{title}</h3>{body}")
    return "".join(parts)


def _rows(rows: list[tuple[Case | None, Row]]) -> str:
    """The comparison, a line a row; with the case where rows of several are gathered."""
    gathered = any(case is not None for case, _ in rows)
    lines, last = [], ""
    for case, row in rows:
        known, value = row.reference, row.value
        sign, kind, word = SIGNS[row.state]
        off, used = "", ""
        if value is not None and known.value is not None:
            off = known.deviation(value).replace("-", "−")
            if off and not off.endswith("%"):
                off += {"deg": "°", "1": ""}.get(known.unit, f" {known.unit}")
            share = known.used(value)
            if share is not None and share == share:
                used = (
                    f'<span class="used" title="{100 * share:.0f} % of the band">'
                    f'<i style="width:{100 * min(share, 1.0):.0f}%"></i></span>'
                )
        alone = known.tolerance in ("max", "min") or (known.tolerance, known.value) == ("report", 0)
        reason = ""
        if known.limitation:
            text = "(for the same reason)" if known.limitation == last else known.limitation
            reason = f'<span class="reason">{escape(text)}</span>'
        last = known.limitation
        of_case = ""
        if case is not None:
            of_case = f'<td><a href="#case-{case.name}">{escape(case.name)}</a></td>'
        lines.append(
            f'<tr class="{kind}"><td class="state">{sign} {word}</td>{of_case}'
            f"<td class='name'>{escape(known.name)}{reason}</td>"
            f'<td class="n">{quantity(value, known.unit)}</td>'
            f'<td class="n">{"" if alone else quantity(known.value, known.unit)}</td>'
            f'<td class="n">{off}</td><td class="n">{band(row)}{used}</td>'
            f"<td>{known.standing}</td><td class='source'>{escape(known.source)}</td></tr>"
        )
    head = (
        f"<th></th>{'<th>case</th>' if gathered else ''}<th>quantity</th>"
        '<th class="n">computed</th><th class="n">reference</th><th class="n">off by</th>'
        '<th class="n">band (used)</th><th>standing</th><th>source</th>'
    )
    return _table(head, lines)


def _table(head: str, lines: list[str]) -> str:
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def _legend() -> str:
    words = {
        HELD: "the computed value is inside the band",
        MISSED: "it is not, or is no number; the exit status says so",
        MISSING: "the case did not return it; counts as missed",
        LIMITATION: "the model is known to be off here, for the reason given; the row has a band "
        "of its own, and being inside says that it is off by as much as is known",
        AWAITED: "nobody has given the measured value yet; neither held nor missed",
        SHOWN: "a value without a band, for the record; neither held nor missed",
        LEFT_OUT: "the quick suite does not compute this row (or only it does)",
    }
    states = [
        f'<tr class="{SIGNS[state][1]}"><td class="state">{SIGNS[state][0]} {SIGNS[state][2]}</td>'
        f"<td>{text}</td></tr>"
        for state, text in words.items()
    ]
    standings = [f"<tr><td>{name}</td><td>{text}</td></tr>" for name, text in MEANINGS.items()]
    return f"""<div class="columns legend">
{_table("<th>row</th><th></th>", states)}
{_table("<th>standing</th><th></th>", standings)}
</div>
<p>The bar beside a band shows how much of it is used; a full bar is the edge. Lengths are in mm,
forces in N, stresses in MPa, angles in degrees. γ is the shear angle: how far the angle between
warp and weft has moved from 90°; E11 and E22 are the Green strains along warp and weft.</p>"""


def _case(case: Case) -> str:
    """One case: what is compared and why, numbers, pictures, sheets."""
    parts = [_readme(case.name)]
    if case.problem:
        parts.append(f'<p class="problem">{escape(case.problem)}</p>')
    rows = [(None, row) for row in case.rows if row.state != LEFT_OUT]
    left_out = [(None, row) for row in case.rows if row.state == LEFT_OUT]
    if rows:
        parts.append(_rows(rows))
    if left_out:
        suite = left_out[0][1].reference.only
        words = f"Rows that only the {suite} suite computes: {len(left_out)}"
        parts.append(f"<details><summary>{words}</summary>{_rows(left_out)}</details>")
    if case.notes:
        notes = "".join(f"<li>{_markdown(note, inline=True)}</li>" for note in case.notes)
        parts.append(f"<h3>Notes of the run</h3><ul>{notes}</ul>")
    if case.figures:
        pictures = "".join(
            f"<figure>{_picture(path, caption)}<figcaption>{escape(caption)}</figcaption></figure>"
            for caption, path in case.figures
        )
        parts.append(f'<div class="pictures">{pictures}</div>')
    for number, (caption, words, interactive, poster) in enumerate(case.sheets, 1):
        flat = "" if interactive else " flat"
        data = f' data-figure="{case.name}-{number}"' if interactive else ""
        missing = "" if interactive else f" {NO_VIEW}"
        parts.append(
            f'<figure class="formed{flat}"><div class="sheet"{data}></div>'
            f'<p class="probe" aria-live="polite">{HELP}</p>'
            f'<div class="poster">{_picture(poster, caption)}</div>'
            f"<figcaption><b>{escape(caption)}</b>. {escape(words)}."
            f"{missing}</figcaption></figure>"
        )
    return (
        f'<section class="case" id="case-{case.name}"><h2>{_title(case.name)}</h2>'
        f'<p class="quiet"><code>validation/{escape(case.name)}</code> · '
        f"{duration(case.seconds)} · begun {escape(_clock(case.date))}</p>{''.join(parts)}"
        f'<p class="quiet"><a href="#verdict">↑ verdict</a></p></section>\n'
    )


def _study(folder: str, patterns: tuple[str, ...], command: str, words: str) -> str:
    """Pictures that another command has left in its folder, or how to make them."""
    found = [path for pattern in patterns for path in sorted((FOLDER / folder).glob(pattern))]
    if not found:
        return (
            f"<p>{words}</p><p>Not made yet: in a clone, <code>{escape(command)}</code> makes it, "
            "and the next report shows it.</p>"
        )
    pictures = "".join(
        f"<figure>{_picture(path, path.stem)}<figcaption>{escape(path.stem.replace('_', ' '))}"
        "</figcaption></figure>"
        for path in found
    )
    return f"<p>{words} Made by <code>{escape(command)}</code>.</p>{pictures}"


def _made(about: About, done: list[Case]) -> str:
    def pairs(table: dict[str, str]) -> str:
        rows = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in table.items())
        return f"<dl>{rows}</dl>"

    total = {"begun": _day(about.date), "cases": duration(sum(case.seconds for case in done))}
    return (
        f'<div class="columns"><div><h3>Versions</h3>{pairs(about.versions)}</div>'
        f"<div><h3>Machine</h3>{pairs(about.machine | total)}</div></div>"
        '<p class="quiet">The time of a case is that of its calculations and its own pictures, '
        "without the start of Python. Cases run one after another.</p>"
    )


def _figures(done: list[Case]) -> str:
    """The 3D views as data, read when a view comes onto the screen."""
    scripts = []
    for case in done:
        for number, (_, _, interactive, _) in enumerate(case.sheets, 1):
            if interactive:
                content = interactive.read_text(encoding="utf-8")  # numbers, no words of others
                opening = f'<script type="application/json" id="{case.name}-{number}">'
                scripts.append(f"{opening}{content}</script>")
    return "\n".join(scripts)


def _picture(path: Path, words: str) -> str:
    """A picture inside the page."""
    content = path.read_bytes()
    size = ""
    if path.suffix == ".png":  # its header tells the size, so that nothing moves while it loads
        width, height = (int.from_bytes(content[at : at + 4], "big") for at in (16, 20))
        size = f' width="{width}" height="{height}"'
    encoded = base64.b64encode(content).decode()
    return (
        f'<img alt="{escape(words)}" loading="lazy" decoding="async"{size} '
        f'src="data:{TYPES[path.suffix]};base64,{encoded}">'
    )


def _readme(name: str) -> str:
    """The case's README without its title, headings two steps down."""
    _, text = _parts(name)
    return _markdown(text)


def _title(name: str) -> str:
    """The first heading of a case's README."""
    return escape(_parts(name)[0])


def _parts(name: str) -> tuple[str, str]:
    path = FOLDER / name / "README.md"
    if not path.is_file():
        return name, "*This case has no README.*"
    head, _, rest = path.read_text(encoding="utf-8").strip().partition("\n")
    return head.lstrip("# ").strip() or name, rest


def _markdown(text: str, *, inline: bool = False) -> str:
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    if inline:
        return reader.renderInline(text)
    tokens = reader.parse(text)
    for token in tokens:
        if token.type in ("heading_open", "heading_close"):
            token.tag = f"h{min(6, int(token.tag[1]) + 1)}"
    return reader.renderer.render(tokens, reader.options, {})


def _day(date: str) -> str:
    return f"{date[:16].replace('T', ' ')} {date[19:].replace('+00:00', 'UTC')}"


def _clock(date: str) -> str:
    return date[5:16].replace("T", " ")

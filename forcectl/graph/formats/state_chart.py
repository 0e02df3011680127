"""A state machine in every format: modes as boxes, arrows with their guards."""

from __future__ import annotations

from html import escape

import pydot

from forcectl.graph.formats import print as printed
from forcectl.graph.formats import svg
from forcectl.graph.formats.dot import label_of
from forcectl.graph.formats.mermaid import text_of
from forcectl.graph.formats.paint import PALETTE
from forcectl.graph.layout.state_chart import COLOURS, chart_picture
from forcectl.tasks.machine.chart import MachineChart

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{title}</title></head>
<body style="margin:0;overflow:auto">
{svg}</body>
</html>
"""


def to_svg(chart: MachineChart) -> str:
    """The machine as a complete SVG document."""
    picture = chart_picture(chart)
    groups = ((None, role, marks) for role, marks in picture.groups)
    return svg.document(_title(chart), picture.width, picture.height, groups)


def to_html(chart: MachineChart) -> str:
    """The machine as a page."""
    return _PAGE.format(title=escape(_title(chart)), svg=to_svg(chart))


def to_png(chart: MachineChart) -> bytes:
    """The machine as a bitmap."""
    return printed.bitmap(_title(chart), _sheet(chart))


def to_pdf(chart: MachineChart) -> bytes:
    """The machine as one page of lines and text."""
    return printed.page(_title(chart), _sheet(chart))


def to_pydot(chart: MachineChart) -> pydot.Dot:
    """The machine as pydot objects: a `Node` per mode, `m0` and so on, an `Edge` per arrow."""
    dot = pydot.Dot(pydot.make_quoted(chart.name), graph_type="digraph", rankdir="LR", nodesep=0.35, ranksep=0.8)
    dot.set_node_defaults(shape="box", style='"rounded,filled"', fontname="Helvetica", fontsize=11, penwidth=1.2)
    dot.set_edge_defaults(fontname="Helvetica", fontsize=9, color="#2f3c48", fontcolor="#5b6873", arrowsize=0.7)
    number = {mode.name: f"m{i}" for i, mode in enumerate(chart.modes)}
    dot.add_node(pydot.Node("start", shape="point", width=0.12, label=label_of("")))
    for mode in chart.modes:
        fill, line = PALETTE[COLOURS[mode.end]]
        node = pydot.Node(
            number[mode.name], label=label_of("\n".join((mode.name, *mode.notes))), fillcolor=fill, color=line,
            peripheries=2 if mode.end else 1,
        )  # fmt: skip
        dot.add_node(node)
    dot.add_edge(pydot.Edge("start", number[chart.start]))
    for arrow in chart.arrows:
        dot.add_edge(pydot.Edge(number[arrow.source], number[arrow.target], label=label_of(arrow.label)))
    return dot


def to_dot(chart: MachineChart) -> str:
    """The machine as a DOT document."""
    return to_pydot(chart).to_string(indent=2)


def to_mermaid(chart: MachineChart) -> str:
    """The machine as a Mermaid state diagram."""
    number = {mode.name: f"s{i}" for i, mode in enumerate(chart.modes)}
    lines = ["stateDiagram-v2", "  direction LR"]
    for mode in chart.modes:
        lines.append(f'  state "{"<br/>".join(map(text_of, (mode.name, *mode.notes)))}" as {number[mode.name]}')
    lines.append(f"  [*] --> {number[chart.start]}")
    lines += [f"  {number[one.source]} --> {number[one.target]} : {text_of(one.label)}" for one in chart.arrows]
    lines += [f"  {number[mode.name]} --> [*]" for mode in chart.modes if mode.end]
    for end, category in COLOURS.items():
        if members := [number[mode.name] for mode in chart.modes if mode.end == end]:
            fill, line = PALETTE[category]
            lines.append(f"  classDef {end or 'mode'} fill:{fill},stroke:{line},color:#1d2730")
            lines.append(f"  class {','.join(members)} {end or 'mode'}")
    return "\n".join(lines) + "\n"


def _sheet(chart: MachineChart) -> printed.Sheet:
    picture = chart_picture(chart)
    return printed.Sheet(picture.width, picture.height, [(None, role, marks) for role, marks in picture.groups])


def _title(chart: MachineChart) -> str:
    return f"State machine {chart.name}"

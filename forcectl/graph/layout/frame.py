"""The picture of an open diagram from the pictures of its blocks, in one row of columns, or in several if it is wide.

Rows are placed below one another. A wire to the next row leaves at the right, runs between the rows and enters at the
left. A wire to an earlier row runs below all rows and enters at the left, or runs up and enters at the right end,
whichever gives fewer bends and crossings. A signal to another row that also returns in its own row shares that wire.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from forcectl.graph.layout.breaks import in_rows
from forcectl.graph.layout.placed import Picture, PlacedBox, PlacedNet
from forcectl.graph.layout.route import branch_points
from forcectl.graph.layout.rows import Item, Point
from forcectl.graph.layout.shapes import (
    FRAME_NAME,
    FRAME_TITLE,
    SIGNAL_SIZE,
    TITLE_SIZE,
    TYPE_SIZE,
    subtitle,
    text_width,
)
from forcectl.graph.layout.sorting.measure import CROSSING, count_bends, count_crossings
from forcectl.graph.layout.strips import Strips
from forcectl.graph.model import Block, Endpoint

MARGIN = 16.0  # around the picture
_PAD = 14.0  # inside a frame
_WIDEST = {True: 2.5, False: 3.2}  # largest ratio of width to height: of the whole picture, of a nested diagram
_WAYS = 3  # largest number of wires from later rows for which the other route is tried
_NARROW = {True: 1500.0, False: 2000.0}  # [px] width up to which a picture is not broken into rows

Wires = Mapping[Endpoint, Sequence[Endpoint]]


def frame(
    block: Block,
    inner: Sequence[Picture],
    column: Mapping[str, int],
    hints: Mapping[tuple[str, str], float],
    whole: bool,
    careful: bool,
) -> Picture:
    """Picture of an unfolded diagram.

    Args:
        block: the diagram.
        inner: pictures of its blocks.
        column: column of each block, from 1 on.
        hints: order in which the wires of its ports arrive and leave outside, by side and port.
        whole: whether it is the whole picture, which is kept narrower.
        careful: whether alternative routes of wires are tried one by one.
    """
    wires: dict[Endpoint, list[Endpoint]] = defaultdict(list)
    text: dict[Endpoint, str] = {}
    for edge in block.edges:
        wires[edge.source].append(edge.target)
        # A wire into a nested diagram is already labelled outside of it.
        text[edge.source] = "" if edge.source.block == block.path != "" else edge.signal
    labels = {source: text_width(words, SIGNAL_SIZE) for source, words in text.items()}
    last = max(column.values(), default=0)

    def laid_out(cuts: Sequence[int]) -> Strips:
        def led(inward: Collection[tuple[int, Endpoint]]) -> Strips:
            items = {c.path: _item(c, column[c.path], own) for c, own in zip(block.blocks, inner, strict=True)}
            return Strips(block, items, wires, labels, hints, cuts, inward, careful)

        best = led(())
        back = best.leading_back() if careful else []
        if back:
            # A wire from a later row that enters at the right end does not pass the blocks at the left.
            ways = [tuple(back), *((way,) for way in back[:_WAYS] if len(back) > 1)]
            best = min([best, *map(led, ways)], key=lambda strips: _cost(strips, wires))
        return best

    title = FRAME_NAME * text_width(block.name, TITLE_SIZE, bold=True) + text_width(subtitle(block), TYPE_SIZE) + 46.0
    passing = dict.fromkeys(range(1, last + 1), 0)
    for source, targets in wires.items():
        ranks = [column[end.block] for end in (source, *targets) if end.block != block.path]
        for cut in range(min(ranks, default=0), max(ranks, default=0)):
            passing[cut] += 1
    margins = 2 * MARGIN if whole else 0.0
    cost = (lambda strips: _cost(strips, wires)) if careful else None
    best = in_rows(
        laid_out,
        last,
        widest=_WIDEST[whole],
        narrow=_NARROW[whole],
        around=(margins, FRAME_TITLE + 2 * _PAD + margins),
        passing=passing,
        cost=cost,
    )
    best.widen(title)
    return _finished(block, inner, best, wires, text)


def _cost(strips: Strips, wires: Wires) -> tuple[float, int]:
    """Cost of the wires of a layout: bends and crossings, then bends alone."""
    paths = [strips.paths(source) for source in wires]
    bends = count_bends(paths)
    return bends + CROSSING * count_crossings(paths), bends


def _finished(
    block: Block, inner: Sequence[Picture], strips: Strips, wires: Wires, text: Mapping[Endpoint, str]
) -> Picture:
    down = FRAME_TITLE + _PAD
    own = []
    for source, targets in wires.items():
        paths = strips.paths(source)
        x, y = strips.text_at(source)
        dots = tuple(branch_points(paths))
        net = PlacedNet(
            source, tuple(targets), tuple(map(tuple, paths)), dots, text[source], (x + 5.0, y - 4.0), block.path
        )
        own.append(net)
    inside = [
        _as_placed(picture, item).moved(x, y + down)
        for picture, item, (x, y) in zip(inner, strips.items.values(), map(strips.corner, strips.items), strict=True)
    ]
    inside.append(Picture(0.0, 0.0, (), tuple(own)).moved(0.0, down))
    height = strips.height + down + _PAD

    def lowered(places: Mapping[str, Point]) -> tuple[tuple[str, Point], ...]:
        return tuple((name, (x, y + down)) for name, (x, y) in places.items())

    outline = PlacedBox(
        block.path, 0.0, 0.0, strips.width, height, None, lowered(strips.inputs()), lowered(strips.outputs())
    )
    boxes = [outline, *(box for picture in inside for box in picture.boxes)]
    return Picture(strips.width, height, tuple(boxes), tuple(net for picture in inside for net in picture.nets))


def _item(block: Block, rank: int, picture: Picture) -> Item:
    box = picture.boxes[0]
    sides = {"in": box.inputs, "out": box.outputs}
    return Item(
        rank,
        picture.width,
        picture.height,
        ports={side: [name for name, _ in ports] for side, ports in sides.items()},
        slots={side: [place for _, place in ports] for side, ports in sides.items()},
        loose=box.shape is not None and block.type_name not in ("Multiplexer", "Demultiplexer"),
        elastic=box.shape is not None and box.shape.form in ("box", "bar") and bool(box.inputs or box.outputs),
    )


def _as_placed(picture: Picture, item: Item) -> Picture:
    """The picture of a block with its ports in their final order and places, and its final height."""
    inputs, outputs = (tuple(zip(item.ports[side], item.slots[side], strict=True)) for side in ("in", "out"))
    box = replace(picture.boxes[0], height=item.height, inputs=inputs, outputs=outputs)
    if box.shape is not None and (more := item.height - picture.height):
        x, y, width, height = box.shape.body
        taller = replace(box.shape, height=item.height, body=(x, y, width, height + more))
        box = replace(box, shape=taller)
    return replace(picture, height=item.height, boxes=(box, *picture.boxes[1:]))

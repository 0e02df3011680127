"""The rows of an open diagram, each with its own layered layout, and the wires between rows."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence

from forcectl.graph.layout.place import place_rows
from forcectl.graph.layout.route import (
    LANE,
    TRACK,
    Net,
    bend_points,
    set_columns,
    wire_points,
    without_repeats,
)
from forcectl.graph.layout.rows import Columns, End, Item, Point
from forcectl.graph.layout.shapes import PORT_PITCH, PORT_SIZE, text_width
from forcectl.graph.layout.sorting.sweeps import BOTTOM
from forcectl.graph.model import Block, Endpoint

_TERMINAL_LINE = 15.0  # distance from the top of a terminal's name to its wire
_POINT = 12.0  # height of an item where a wire enters or leaves a row
_BETWEEN = 22.0  # distance from row to row, in addition to the wires between them

_Part = tuple[Endpoint, bool]  # source of a signal, and whether it enters the row from outside


class Strip:
    """The layout of one row: its items and the wires between them.

    Args:
        items: items with their columns, from 1 on, and the ends of wires at both sides of the row.
        nets: parts of the signals in this row.
        outside: heights at which the wires of the ends continue outside of the row, as far as known.
        count: number of columns, including those of the ends.
        careful: see `place_rows`.
    """

    def __init__(
        self,
        items: Sequence[Item],
        nets: Mapping[_Part, Net],
        outside: Mapping[Item, float],
        count: int,
        careful: bool,
    ) -> None:
        self.nets = nets
        every = list(nets.values())
        self._number = {part: number for number, part in enumerate(nets)}
        hops, turns = bend_points(every)
        bends = [bend for net in every for bend in net.bends.values()]
        for net in sorted(every, key=lambda net: len(net.returning)):  # long returns run below short ones
            bends += net.returning.values()
        self.columns: Columns = place_rows([*items, *bends], hops, turns, count, outside, careful)
        self.height = max((item.y + item.height for column in self.columns for item in column), default=0.0)
        self.width, self._channels = set_columns(every, self.columns, hops, turns)

    def path(self, part: _Part, target: End) -> list[Point]:
        """Corners of a wire, relative to the corner of the row."""
        return wire_points(self.nets[part], self._number[part], target, self._channels)


class Strips:
    """All rows of a diagram.

    Args:
        block: the diagram.
        items: items of its blocks, with their columns.
        wires: targets of each source.
        labels: widths of the texts at the sources.
        hints: order in which the wires of its ports arrive and leave outside, by side and port.
        cuts: columns after which a row ends.
        inward: (row, signal) for signals from a later row that enter at the right end of the row, instead of running
            around all rows and entering at the left.
        careful: see `place_rows`.
    """

    def __init__(
        self,
        block: Block,
        items: Mapping[str, Item],
        wires: Mapping[Endpoint, Sequence[Endpoint]],
        labels: Mapping[Endpoint, float],
        hints: Mapping[tuple[str, str], float],
        cuts: Sequence[int],
        inward: Collection[tuple[int, Endpoint]] = (),
        careful: bool = True,
    ) -> None:
        self._inward, self._careful = inward, careful
        self._block, self.items, self._wires, self._labels, self._hints = block, items, wires, labels, hints
        self._several = bool(cuts)
        self._label = {port.name: port.label for port in block.outputs}
        first = [1, *(cut + 1 for cut in cuts)]
        last = max((item.rank for item in items.values()), default=0)
        self._ends = [*cuts, last]
        self._row = {path: sum(item.rank > cut for cut in cuts) for path, item in items.items()}
        for path, item in items.items():
            item.rank -= first[self._row[path]] - 1
        self._counts = [end - start + 3 for start, end in zip(first, self._ends, strict=True)]
        # The ends of wires at a row: terminals of the diagram, and the items where a wire goes to or comes from another
        # row.
        self._entries: dict[tuple[int, Endpoint], Item] = {}
        self._exits: dict[tuple[int, Endpoint], Item] = {}
        self._inlets: dict[tuple[int, Endpoint], Item] = {}
        self._terminals: dict[tuple[str, str], tuple[int, Item]] = {}
        self._strips = [self._strip(row) for row in range(len(self._counts))]
        self._join_rows()

    def _strip(self, row: int) -> Strip:
        block, last = self._block, self._counts[row] - 1
        nets: dict[_Part, Net] = {}
        outside: dict[Item, float] = {}
        for port in block.inputs if row == 0 else ():
            source = Endpoint(block.path, port.name)
            if not self._wires.get(source):
                self._terminals["in", port.name] = 0, self._terminal(0, port.name, "out")
        for port in block.outputs if row == 0 else ():
            if not any(Endpoint(block.path, port.name) in targets for targets in self._wires.values()):
                self._terminals["out", port.name] = 0, self._terminal(last, port.name, "in")
        for source, targets in self._wires.items():
            of_block = source.block == block.path
            rows = {self._row[target.block] for target in targets if target.block != block.path}
            home = min(rows, default=0) if of_block else self._row[source.block]
            here: list[End] = []
            if row == home:
                for target in targets:
                    if target.block == block.path:
                        item = self._terminal(last, target.port, "in")
                        self._terminals["out", target.port] = row, item
                        self._set_hint(outside, item, "out", target.port)
                        here.append((item, target.port))
            here += [
                (self.items[t.block], t.port) for t in targets if t.block != block.path and self._row[t.block] == row
            ]
            if of_block:
                if row == home:
                    start: End = self._terminal(0, source.port, "out"), source.port
                    self._terminals["in", source.port] = row, start[0]
                    self._set_hint(outside, start[0], "in", source.port)
                elif row in rows:
                    start = self._point(0, "out", source.port), source.port
                    self._entries[row, source] = start[0]
                else:
                    continue
            elif row == home:
                start = self.items[source.block], source.port
                if rows - {row}:
                    leaving = self._point(last, "in", source.port)
                    self._exits[row, source] = leaving
                    upwards = all((other, source) in self._inward for other in rows - {row})
                    outside[leaving] = -BOTTOM if upwards else BOTTOM
                    back = [] if upwards else [end for end in here if end[0].rank <= start[0].rank]
                    here = [*(end for end in here if end not in back), (leaving, source.port)]
                    if back:  # these targets are reached around the row, with the wire to the next row
                        point = self._point(0, "out", source.port)
                        self._entries[row, source], outside[point] = point, BOTTOM
                        nets[source, True] = Net((point, source.port), back)
            elif (row, source) in self._inward:
                start = self._point(last, "in", source.port), source.port
                self._inlets[row, source] = start[0]
                outside[start[0]] = 2.0 * BOTTOM
            elif row in rows:
                start = self._point(0, "out", source.port), source.port
                self._entries[row, source] = start[0]
                came = self._exits.get((home, source))
                # Wires from an earlier row keep their order; those from a later row enter below them.
                outside[start[0]] = BOTTOM if came is None else came.y
            else:
                continue
            enters = (row, source) in self._inlets
            nets[source, row != home] = Net(start, here, self._labels[source] if row == home else 0.0, enters)
        ends = [item for at, item in self._terminals.values() if at == row]
        ends += [
            item
            for points in (self._entries, self._exits, self._inlets)
            for (at, _), item in points.items()
            if at == row
        ]
        own = [item for path, item in self.items.items() if self._row[path] == row]
        return Strip([*ends, *own], nets, outside, last + 1, self._careful)

    def _set_hint(self, outside: dict[Item, float], item: Item, side: str, port: str) -> None:
        if (hint := self._hints.get((side, port))) is not None:
            outside[item] = hint

    def _terminal(self, rank: int, port: str, side: str) -> Item:
        """Item of a port of the diagram itself; its wire starts or ends at the border, below the name."""
        width = 0.0 if self._several else text_width(port if side == "out" else self._label[port], PORT_SIZE) + 14.0
        at = (0.0 if side == "out" else width, _TERMINAL_LINE)
        return Item(rank, width, PORT_PITCH, {side: [port]}, {side: [at]}, terminal=True)

    def _point(self, rank: int, side: str, port: str) -> Item:
        return Item(rank, 0.0, _POINT, {side: [port]}, {side: [(0.0, _POINT / 2.0)]}, terminal=True)

    def _join_rows(self) -> None:
        """Stack the rows, and route the wires between them."""
        between: dict[int, list[Endpoint]] = defaultdict(list)  # row -> the wires that run below it
        bottom = len(self._strips) - 1
        upwards: list[Endpoint] = []  # from the uppermost on
        for (row, source), _ in sorted(self._exits.items(), key=lambda one: -one[1].y):
            others = [at for at, entering in self._entries if entering == source]
            if others:
                between[bottom if min(others) < row else row].append(source)
            else:
                upwards.insert(0, source)
        home = {source: row for row, source in self._exits}
        down = [s for row in range(bottom) for s in between[row] if home[s] == row]
        around = sorted(between[bottom], key=lambda source: home[source] != bottom)
        from_border = [s for s in self._wires if s.block == self._block.path and any(e == s for _, e in self._entries)]
        self._left: dict[Endpoint, float] = {}
        self._right: dict[Endpoint, float] = {}
        self._lane: dict[Endpoint, float] = {}
        names = {side: self._names(side) for side in ("in", "out")}
        # From the outside in: wires to earlier rows, wires of the border, wires to the next row; upper lanes further
        # out.
        order = [*around[::-1], *from_border, *down]
        if self._several:
            for number, source in enumerate(order):
                self._left[source] = names["in"] + 8.0 + TRACK * number
        self._begin = names["in"] + (TRACK * len(order) + 14.0 if order else 0.0)
        # Wires that continue below their own row run down beside it, all others outside of all rows.
        close = {row: [s for s in between[row] if home[s] == row] for row in range(bottom + 1)}
        end = max(strip.width for strip in self._strips)
        for row, strip in enumerate(self._strips):
            for number, source in enumerate(close[row]):
                self._right[source] = self._begin + strip.width + 6.0 + TRACK * number
                end = max(end, strip.width + TRACK * (number + 1) + 8.0)
        far = [*(source for source in around if home[source] != bottom), *upwards]
        for number, source in enumerate(far):
            self._right[source] = self._begin + end + 6.0 + TRACK * number
        end += TRACK * len(far) + 8.0 if far else 0.0
        y = 0.0
        self._tops = []
        for row, strip in enumerate(self._strips):
            self._tops.append(y)
            y += strip.height
            lanes = between[row]
            for number, source in enumerate(lanes):
                self._lane[source] = y + 16.0 + LANE * number
            if row < bottom:
                y += _BETWEEN + (16.0 + LANE * (len(lanes) - 1) if lanes else 0.0)
            elif lanes:
                y += 16.0 + LANE * (len(lanes) - 1)
        self.height = y
        for (side, _), (row, item) in self._terminals.items():
            if side == "out":
                item.x += end - self._strips[row].width
        self.width = self._begin + end + names["out"]

    def _names(self, side: str) -> float:
        """Width of the column with the names of the diagram's ports at one side; 0 for a single row."""
        names = [name for at, name in self._terminals if at == side]
        return (
            max(
                (text_width(name if side == "in" else self._label[name], PORT_SIZE) + 16.0 for name in names),
                default=0.0,
            )
            if self._several
            else 0.0
        )

    def widen(self, width: float) -> None:
        """Widen the diagram to at least this width."""
        if (more := width - self.width) > 0.0:
            self.width = width
            for (side, _), (_, item) in self._terminals.items():
                if side == "out":
                    item.x += more

    def inputs(self) -> dict[str, Point]:
        """Positions of the diagram's inputs."""
        return {port.name: self._at_border("in", port.name) for port in self._block.inputs}

    def outputs(self) -> dict[str, Point]:
        """Positions of the diagram's outputs."""
        return {port.name: self._at_border("out", port.name) for port in self._block.outputs}

    def _at_border(self, side: str, port: str) -> Point:
        row, item = self._terminals[side, port]
        return 0.0 if side == "in" else self.width, item.y + _TERMINAL_LINE + self._tops[row]

    def text_at(self, source: Endpoint) -> Point:
        """Position at which the text of a signal starts."""
        if source.block == self._block.path:
            x, y = self._at_border("in", source.port)
            return x + text_width(source.port, PORT_SIZE) + 14.0, y
        return self._moved_point(self._row[source.block], self.items[source.block].place("out", source.port))

    def paths(self, source: Endpoint) -> list[list[Point]]:
        """The wires of a signal, in the order of its targets."""
        block = self._block.path
        of_block = source.block == block
        home = self._terminals["in", source.port][0] if of_block else self._row[source.block]
        found = []
        for target in self._wires[source]:
            row = home if target.block == block else self._row[target.block]
            end = (
                (self._terminals["out", target.port][1] if target.block == block else self.items[target.block]),
                target.port,
            )
            back = not of_block and end[0].rank <= self.items[source.block].rank
            outside = row != home or (back and (row, source) in self._entries)
            points = self._moved(row, (source, outside), end)
            if outside:
                y = points[0][1]
                left = self._left.get(source, 0.0)
                if of_block:
                    start = self._at_border("in", source.port)
                    points = [start, (left, start[1]), (left, y), *points]
                else:
                    right = self._right[source]
                    before = self._moved(home, (source, False), (self._exits[home, source], source.port))
                    if (row, source) in self._inward:
                        found.append(without_repeats([*before, (right, before[-1][1]), (right, y), *points]))
                        continue
                    lane = self._lane[source]
                    points = [*before, (right, before[-1][1]), (right, lane), (left, lane), (left, y), *points]
            elif of_block:
                points = [self._at_border("in", source.port), *points]
            if target.block == block:
                points.append(self._at_border("out", target.port))
            found.append(without_repeats(points))
        return found

    def _moved(self, row: int, part: _Part, end: End) -> list[Point]:
        return [self._moved_point(row, point) for point in self._strips[row].path(part, end)]

    def _moved_point(self, row: int, point: Point) -> Point:
        return point[0] + self._begin, point[1] + self._tops[row]

    def corner(self, path: str) -> Point:
        """Upper left corner of a block."""
        item = self.items[path]
        return self._moved_point(self._row[path], (item.x, item.y))

    def leading_back(self) -> list[tuple[int, Endpoint]]:
        """(row, signal) for every signal that enters a row from a later one."""
        of_blocks = [(row, source) for row, source in self._entries if source.block != self._block.path]
        return [(row, source) for row, source in of_blocks if self._row[source.block] > row]

    def spans(self) -> list[float]:
        """Width of each column of blocks in a single row, including the channel to its right."""
        (strip,) = self._strips
        starts = [min(item.x for item in column if not item.wire) for column in strip.columns[1:-1]]
        return [after - before for before, after in itertools.pairwise([*starts, strip.width])]

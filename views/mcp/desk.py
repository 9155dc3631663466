"""The bus as the tools see it: descriptions of nodes, their semantic models, their events, and the writer."""

from __future__ import annotations

import threading
from collections import OrderedDict
from pathlib import Path
from types import TracebackType
from typing import Generic, TypeVar

from zenostat.agent_sdk.semantic import SemanticGraph
from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import RequestRejected
from zenostat.topics.messages import Manifest
from zenostat.topics.points import value_index
from zenostat.views.mcp.event_log import EventLog
from zenostat.views.mcp.writer import Writer
from zenostat.views.room.description import NodeDescription, describe

_REQUEST_S = 60.0
_KEPT = 16

T = TypeVar("T")


class _Latest(Generic[T]):
    """The latest values that were put, by name; for several threads."""

    def __init__(self) -> None:
        self._values: OrderedDict[str, T] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, name: str) -> T | None:
        with self._lock:
            return self._values.get(name)

    def put(self, name: str, value: T) -> None:
        with self._lock:
            self._values[name] = value
            self._values.move_to_end(name)
            while len(self._values) > _KEPT:
                self._values.popitem(last=False)


class Desk:
    """A connection to the bus for tools, which may call it from several threads.

    Args:
        bus: connection to the bus; the caller closes it after this.
        source: name under which requests are sent.
        writer: writes what is permitted; None: nothing is.
        reports: folder for reports; None: reports are not written to files.

    Attributes:
        simulating: held by what simulates on branches: one at a time.
        drawing: held by what draws with Matplotlib, whose settings are global.
    """

    def __init__(self, bus: Bus, source: str, *, writer: Writer | None = None, reports: Path | None = None) -> None:
        bus.timeout_s = _REQUEST_S
        self.bus, self.source, self.writer, self.reports = bus, source, writer, reports
        self.events = EventLog(bus)
        self.simulating, self.drawing = threading.Lock(), threading.Lock()
        self._descriptions: _Latest[NodeDescription] = _Latest()
        self._models: _Latest[SemanticGraph] = _Latest()

    def __enter__(self) -> Desk:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.events.close()

    def description(self, node: str) -> NodeDescription:
        """Return the description of a node, made once for each instance.

        Raises:
            NodeNotFound: no such node; the text lists similar names.
        """
        manifest = self.bus.manifest(node)
        known = self._descriptions.get(node)
        if known is None or known.manifest != manifest:
            known = describe(manifest, None)
            self._descriptions.put(node, known)
        return known

    def sample(self, manifest: Manifest) -> SampleView | None:
        """Return slot 0 of a node's latest sample; None if there is none yet."""
        try:
            message = self.bus.latest(manifest.node)
        except RequestRejected:
            return None
        return SampleView(message, manifest, value_index(manifest))

    def semantic_model(self, manifest: Manifest) -> SemanticGraph:
        """Return the semantic model of a node's building, read once for each instance.

        Raises:
            RequestRejected: its plant has none.
            InvalidConfig: it is not valid.
        """
        key = f"{manifest.node}/{manifest.instance}"
        model = self._models.get(key)
        if model is None:
            model = SemanticGraph.parse(self.bus.semantic(manifest.node))
            self._models.put(key, model)
        return model

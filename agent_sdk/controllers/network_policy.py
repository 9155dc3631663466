"""A trained network as arrays in a file, applied by NumPy: no pickled objects, no torch.

The file is an uncompressed or compressed `.npz` of NumPy with the weights, the bounds of observations and actions, the
normalization of observations, and a header as JSON. `zenostat.training.export_policy` writes it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any
from zipfile import ZipFile, ZipInfo

import numpy as np
from gymnasium.spaces import Box
from numpy.lib import format as npy
from numpy.typing import NDArray

from zenostat.agent_sdk.controllers.base import Controller
from zenostat.agent_sdk.controllers.wrapped_policy import WrappedPolicy
from zenostat.agent_sdk.wrappers.serialization import check_wrappers
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.messages import Manifest
from zenostat.topics.user_file import user_file

FORMAT = 1
ACTIVATIONS: dict[str, Callable[[NDArray[np.float32]], NDArray[np.float32]]] = {
    "tanh": np.tanh,
    "relu": lambda values: np.maximum(values, np.float32(0.0)),
}
_HEADER = "header"
_BOUNDS = ("observation_low", "observation_high", "action_low", "action_high")
_NORMALIZATION = ("mean", "variance")
_MAX_BYTES = 64_000_000

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class NetworkPolicy:
    """A feedforward network from observations to actions, with the interface of a model of stable-baselines3.

    Attributes:
        layers: `linear`, or the name of an activation function, in the order in which they are applied.
        squashed: the output is squashed by tanh and scaled to the bounds of actions; otherwise it is clipped to them.
        clip_observations: bound of normalized observations.
        epsilon: added to the variance of observations.
        wrappers: the wrappers of the training, innermost first.
        states: what they have learned, from the outermost.
        record: how it was made, for users.
        arrays: `weight_0`, `bias_0`, …, bounds, and `mean` and `variance` of observations if they are normalized.
    """

    layers: tuple[str, ...]
    squashed: bool
    arrays: Arrays
    clip_observations: float = 10.0
    epsilon: float = 1e-8
    wrappers: tuple[dict[str, Any], ...] = ()
    states: tuple[dict[str, Any], ...] = ()
    record: Mapping[str, Any] = field(default_factory=dict)

    @property
    def observation_space(self) -> Box:
        """Space of observations."""
        return Box(self.arrays["observation_low"], self.arrays["observation_high"], dtype=np.float32)

    @property
    def action_space(self) -> Box:
        """Space of actions."""
        return Box(self.arrays["action_low"], self.arrays["action_high"], dtype=np.float32)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,  # noqa: ARG002  # it is not recurrent
        *,
        deterministic: bool = True,  # noqa: ARG002  # it does not explore
    ) -> tuple[NDArray[np.float32], Any]:
        """Return the action for one observation, shape (actions,), and the state as it is."""
        values = np.asarray(observation, np.float32)
        if "mean" in self.arrays:
            scaled = (values - self.arrays["mean"]) / np.sqrt(self.arrays["variance"] + self.epsilon)
            values = np.clip(scaled, -self.clip_observations, self.clip_observations).astype(np.float32)
        values = values.ravel()  # an observation of several dimensions, such as of stacked frames
        index = 0
        for layer in self.layers:
            if layer == "linear":
                values = self.arrays[f"weight_{index}"] @ values + self.arrays[f"bias_{index}"]
                index += 1
            else:
                values = ACTIVATIONS[layer](values)
        low, high = self.arrays["action_low"], self.arrays["action_high"]
        if self.squashed:
            values = low + np.float32(0.5) * (np.tanh(values) + np.float32(1.0)) * (high - low)
        return np.clip(values, low, high), state

    def digest(self) -> str:
        """Return the sha256 of all that determines its actions."""
        content = sha256(json.dumps(self._header(), sort_keys=True).encode())
        for name, array in sorted(self.arrays.items()):
            content.update(f"{name} {array.dtype.str} {array.shape}".encode())
            content.update(np.ascontiguousarray(array).tobytes())
        return content.hexdigest()

    def _header(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "layers": list(self.layers),
            "squashed": self.squashed,
            "clip_observations": self.clip_observations,
            "epsilon": self.epsilon,
            "wrappers": list(self.wrappers),
            "states": list(self.states),
        }

    def save(self, path: str | Path) -> None:
        """Write the policy atomically; the same policy gives the same bytes."""
        header = json.dumps({**self._header(), "record": dict(self.record)}, sort_keys=True).encode()
        with atomic_file(Path(path)) as temporary, temporary.open("wb") as file:
            arrays: Any = {_HEADER: np.frombuffer(header, np.uint8), **self.arrays}
            np.savez_compressed(file, **arrays)

    def controller(self, manifest: Manifest) -> Controller:
        """Return the policy as a controller of a node.

        Raises:
            ControllerMismatch: it was trained on other observations or actions.
        """
        return WrappedPolicy(manifest, self, None, self.wrappers, self.states)


def load_network(path: str | Path) -> NetworkPolicy:
    """Read a policy that `NetworkPolicy.save` wrote. Its content is data: nothing of it is executed.

    Raises:
        UnknownName: there is no such file, or it cannot be read.
        InvalidConfig: it is not such a file, or its arrays do not fit together.
    """
    path = Path(path).expanduser()
    with user_file(path, UnknownName, "an exported policy"):
        path.open("rb").close()
    try:
        with ZipFile(path) as archive:
            members = archive.infolist()
            size = sum(member.file_size for member in members)
            if size > _MAX_BYTES:
                raise ValueError(f"{size:,} bytes; at most {_MAX_BYTES:,} expected")
            arrays = {member.filename.removesuffix(".npy"): _array(archive, member) for member in members}
        header = json.loads(arrays.pop(_HEADER).tobytes())
        policy = _read(header, arrays)
    except Exception as error:  # zipfile, zlib and NumPy raise a dozen unrelated classes for damaged files
        raise InvalidConfig(f"{path} is not a policy that Zenostat exported: {type(error).__name__}: {error}") from None
    check_wrappers(policy.wrappers)
    return policy


def _array(archive: ZipFile, member: ZipInfo) -> NDArray[Any]:
    """Return an array of the file; nothing is allocated for more values than the file has."""
    with archive.open(member) as file:
        if npy.read_magic(file) != (1, 0):  # type: ignore[no-untyped-call,unused-ignore]
            raise ValueError(f"{member.filename} is not an array of NumPy's format 1.0")
        shape, is_fortran, dtype = npy.read_array_header_1_0(file)  # type: ignore[no-untyped-call,unused-ignore]
        if dtype.hasobject:
            raise ValueError(f"{member.filename} has objects; numbers expected")
        content = file.read()
    size = math.prod(shape) * dtype.itemsize
    if size != len(content):
        raise ValueError(f"{member.filename} has {len(content):,} bytes of values; {size:,} expected for {shape}")
    return np.frombuffer(content, dtype).reshape(shape, order="F" if is_fortran else "C")


def _read(header: Mapping[str, Any], arrays: Arrays) -> NetworkPolicy:
    if header["format"] != FORMAT:
        raise ValueError(f"format {header['format']}, expected {FORMAT}")
    layers = tuple(str(layer) for layer in header["layers"])
    if unknown := sorted(set(layers) - {"linear", *ACTIVATIONS}):
        raise ValueError(f"unknown layers {', '.join(unknown)}")
    policy = NetworkPolicy(
        layers, bool(header["squashed"]), arrays, float(header["clip_observations"]), float(header["epsilon"]),
        tuple(map(dict, header["wrappers"])), tuple(map(dict, header["states"])), dict(header["record"]),
    )  # fmt: skip
    count = layers.count("linear")
    expected = [*_BOUNDS, *(f"{kind}_{index}" for index in range(count) for kind in ("weight", "bias"))]
    expected += _NORMALIZATION if "mean" in arrays else ()
    if sorted(expected) != sorted(arrays):
        raise ValueError(f"the arrays {', '.join(sorted(expected))} expected, got {', '.join(sorted(arrays))}")
    if any(not np.issubdtype(array.dtype, np.floating) for array in arrays.values()):
        raise ValueError("arrays of floating-point numbers expected")
    action, _ = policy.predict(np.zeros(arrays["observation_low"].shape, np.float32))
    if action.shape != arrays["action_low"].shape or not np.isfinite(action).all():
        raise ValueError("the network has no finite action")
    return policy

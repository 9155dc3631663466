"""Load controllers by short name, or the user's own class from a file or a module."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from zenostat.agent_sdk.controllers.base import Controller, ControllerProtocol
from zenostat.agent_sdk.controllers.controller_file import read_controller_file
from zenostat.agent_sdk.controllers.parameters import check_parameters, with_parameters
from zenostat.agent_sdk.controllers.training_folder import policy_files
from zenostat.bridge.runtime.source_loader import importable, load_file
from zenostat.bridge.runtime.user_code import describe_user_error
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.user_file import check_user_file

CONTROLLERS: dict[str, type[Controller]] = {}
"""Controllers by short name, as for `zenostat run --controller`; the package fills it."""


def load_controller(text: str) -> Callable[..., ControllerProtocol]:
    """Load the class of a controller, to be called with the node's manifest and parameters by name.

    Args:
        text: a short name; the folder of a training, or `ppo:model.zip` (see `zenostat.training.load_policy`); a policy
            that was exported to a file `.npz`;
            `path/to/file.py:MyController`; or `package.module:MyController`, also for modules in the current folder.
            While the file is loaded, it can import modules from its own folder, which take precedence
            over installed modules of the same name. `FILE.yaml` is a controller file, as `zenostat tune` writes it:
            a bundled controller with parameters. `CONTROLLER@FILE.yaml` is any of the above with the parameters of
            such a file.

    Raises:
        UnknownName: no such name, folder, file, module or class.
        InvalidConfig: loading the file fails, or the class is not a controller; or a controller file is invalid, or
            names code.
    """
    if text in CONTROLLERS:
        return CONTROLLERS[text]
    if text.casefold().endswith((".yaml", ".yml")):
        return _load_file_of_parameters(text)
    if text.casefold().endswith(".npz"):
        from zenostat.agent_sdk.controllers.network_policy import load_network

        return load_network(text).controller
    if _is_policy(text):
        from zenostat.agent_sdk.controllers.policy_loader import load_policy  # torch takes seconds to import

        return load_policy(text)
    source, colon, name = text.rpartition(":")
    if not colon and "/" in text and not text.endswith(".py"):
        raise UnknownName(f"there is no folder {Path(text).expanduser().absolute()} to load a controller from")
    if not colon or not source or not name:
        known = did_you_mean(text, CONTROLLERS, limit=len(CONTROLLERS))
        raise UnknownName(
            f"no controller {text!r}; {known}; load your own class by path/to/file.py:MyController or "
            f"package.module:MyController"
        )
    return _controller_class(_load_module(source), name, source)


def controller_files(text: str) -> list[Path]:
    """Return the files that determine the commands of a controller: none of a bundled one, or of one in a module.

    Args:
        text: as for `load_controller`, but without `@FILE.yaml`. Of a class it is the file that is named, without what
            that imports.

    Raises:
        InvalidConfig: the folder of a training has no model yet.
    """
    if text in CONTROLLERS:
        return []
    if text.casefold().endswith((".yaml", ".yml", ".npz")):
        return [Path(text).expanduser()]
    if _is_policy(text):
        return policy_files(Path(text.partition(":")[2] or text).expanduser())
    source = text.rpartition(":")[0]
    return [Path(source).expanduser()] if _is_file(source) else []


def _is_policy(text: str) -> bool:
    return text.casefold().endswith(".zip") or (":" not in text and Path(text).expanduser().is_dir())


def _is_file(source: str) -> bool:
    return source.endswith(".py") or "/" in source


def _load_file_of_parameters(text: str) -> Callable[..., ControllerProtocol]:
    """Load a bundled controller with the parameters of a file, or (`CONTROLLER@FILE.yaml`) the one that is named.

    A file is data, so it may choose a bundled controller, but no code: a class has to be named outside of it.
    """
    name, at, path = text.rpartition("@")
    file = read_controller_file(Path(path if at else text))
    if not at and file.controller not in CONTROLLERS:
        raise InvalidConfig(
            f"{text} names the controller {file.controller!r}, which is not a bundled one "
            f"({', '.join(CONTROLLERS)}); a file does not choose code: name it yourself, as {file.controller}@{text}"
        )
    factory = load_controller(name if at else file.controller)
    check_parameters(factory, file.parameters)
    return with_parameters(factory, file.parameters)


def _load_module(source: str) -> ModuleType:
    path = Path(source).expanduser()
    is_file = _is_file(source)
    if is_file:
        check_user_file(path, UnknownName, "a Python file")
    folder = path.absolute().parent if is_file else Path.cwd()
    try:
        with importable(folder):
            if not is_file:
                return importlib.import_module(source)
            if path.suffix != ".py":
                raise ImportError(f"{path} is not a Python file")
            return load_file(f"_controller_{path.stem}", path.absolute())
    except (Exception, SystemExit) as error:
        if isinstance(error, ModuleNotFoundError) and error.name and f"{source}.".startswith(f"{error.name}."):
            raise UnknownName(f"there is no module {source!r}, neither installed nor in {folder}") from None
        raise InvalidConfig(f"loading {source} failed: {describe_user_error(error)}") from error


def _controller_class(module: ModuleType, name: str, source: str) -> Callable[..., ControllerProtocol]:
    candidate = getattr(module, name, None)
    if candidate is None:
        controllers = [n for n, value in vars(module).items() if _is_controller(value)]
        raise UnknownName(f"there is no {name!r} in {source}; {did_you_mean(name, controllers)}")
    if not _is_controller(candidate):
        raise InvalidConfig(f"{name} of {source} is not a controller: expected a class with a method act(sample)")
    if inspect.isabstract(candidate):
        raise InvalidConfig(f"{name} of {source} is not a controller: its act(sample) is abstract")
    if all(p.kind is p.KEYWORD_ONLY for p in inspect.signature(candidate).parameters.values()):
        raise InvalidConfig(
            f"{name} of {source} is not a controller: it has to accept the manifest, as __init__(self, manifest)"
        )
    controller_class: Callable[..., ControllerProtocol] = candidate
    return controller_class


def _is_controller(value: object) -> bool:
    return isinstance(value, type) and callable(getattr(value, "act", None))

"""Model files: `NAME.model.toml`, and the network's weights in `NAME.model.npz`."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from trimtab.host.base import artefacts, bounds
from trimtab.host.base.errors import UsageError
from trimtab.host.base.text import file_name, readable
from trimtab.host.models.model import Assessment, Covariance, Model, VerdictCode, network_digest
from trimtab.host.models.network import Frame, Layout, Network
from trimtab.host.models.region import Region
from trimtab.host.vehicle.canonical_toml import write_toml
from trimtab.host.vehicle.strict_toml import ConfigurationError, Strict, read_strict

SUFFIX = ".model.toml"
_Id = Annotated[str, Field(pattern=r"^[0-9a-f]{12}$")]
_Matrix = tuple[tuple[float, ...], ...]
_Table = Mapping[str, Mapping[str, float]]
_Provenance = Mapping[str, str | int | float | Mapping[str, str]]


class ModelFileError(UsageError):
    """A model file cannot be written or used."""


class _CovarianceTable(Strict):
    names: tuple[str, ...]
    matrix: _Matrix


class _NetworkTable(Strict):
    hidden: tuple[int, ...]
    frame: Frame = "world"
    file: str
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class _RegionTable(Strict):
    speed_max_m_s: float
    tilt_max_deg: float
    thrust_min_n: float
    thrust_max_n: float


class _AssessmentTable(Strict):
    verdict: VerdictCode
    probabilities: Mapping[str, float] = Field(default_factory=dict)
    held_out_flights: int = 0
    before_m: float | None = None
    after_m: float | None = None


class _File(Strict):
    kind: Literal["trimtab-model"]
    version: Literal[1]
    id: _Id | None = None
    vehicle_id: _Id
    vehicle_name: str
    data: tuple[str, ...] = ()
    effects: _Table = Field(default_factory=dict)
    adjustments: _Table = Field(default_factory=dict)
    sources: Mapping[str, str] = Field(default_factory=dict)
    covariance: _CovarianceTable | None = None
    network: _NetworkTable | None = None
    region: _RegionTable | None = None
    assessment: _AssessmentTable | None = None
    provenance: _Provenance = Field(default_factory=dict)


def write_model(model: Model, path: Path | str, *, force: bool = False) -> Path:
    """Write a model and return its path.

    The weights of a network are written first, beside it, and the model last. Each file appears whole or not
    at all.

    Parameters
    ----------
    model
        Model to write.
    path
        File to write, .model.toml.
    force
        Overwrite the file.

    Returns
    -------
    Path
        The path of the model.

    Raises
    ------
    UsageError
        If the name does not end in .model.toml, or if the file exists and `force` is not set.
    """
    path = Path(path)
    if not path.name.endswith(SUFFIX):
        raise ModelFileError(f"{path}: a model's name ends in {SUFFIX}")
    artefacts.check_output(path, force)
    weights = path.with_name(path.name.removesuffix(".toml") + ".npz")
    content = model.content()
    network = content.pop("network", None)
    if network is not None:
        network["file"] = weights.name
    table = _File(
        kind="trimtab-model",
        version=1,
        id=model.id,
        vehicle_id=model.vehicle_id,
        vehicle_name=model.vehicle_name,
        data=model.data,
        effects=content["effects"],
        adjustments=content["adjustments"],
        sources=content["sources"],
        covariance=None if model.covariance is None else _CovarianceTable(**content["covariance"]),
        network=None if network is None else _NetworkTable(**network),
        region=None if model.region is None else _RegionTable(**content["region"]),
        assessment=None if model.assessment is None else _AssessmentTable(**content["assessment"]),
        provenance={key: value for key, value in model.provenance.items() if value is not None},
    )
    try:
        with artefacts.open_atomic(path, force, alone=True) as file:
            if model.network is not None:
                with artefacts.open_atomic(weights, force=True) as arrays:
                    np.savez(arrays, xi=model.network.xi)
            file.write(readable(write_toml(table)).encode())
        return path
    except OSError as error:
        raise ModelFileError(f"{path}: cannot be written: {error.strerror}") from error


def read_model(path: Path | str, *, vehicle_id: str | None = None) -> Model:
    """Return the model in a file.

    Parameters
    ----------
    path
        Model, .model.toml. The weights of its network are read from the file beside it.
    vehicle_id
        Id of the vehicle that the model must be of. Default: any.

    Returns
    -------
    Model
        Effects with values in the units of their parameters, covariance, and network.

    Raises
    ------
    ConfigurationError
        With every problem of the TOML.
    UsageError
        If the file or its weights are missing or changed, or if it is of another vehicle.
    """
    path = Path(path)
    try:
        text = bounds.read_text(path, bounds.TOML_BYTES)
    except bounds.TooLarge as error:
        raise ModelFileError(f"{path}: {error}") from None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ModelFileError(
            f"{path}: cannot be read ({reason}); give a {SUFFIX} file that trace or learn wrote"
        ) from error
    table = read_strict(text, path.name, _File)
    try:
        model = Model(
            vehicle_id=table.vehicle_id,
            vehicle_name=table.vehicle_name,
            effects=table.effects,
            adjustments=table.adjustments,
            covariance=None if table.covariance is None else Covariance(**_plain(table.covariance)),
            sources=table.sources,
            network=None if table.network is None else _read_network(path, table.network),
            region=None if table.region is None else Region(**_plain(table.region)),
            data=table.data,
            assessment=None if table.assessment is None else Assessment(**_plain(table.assessment)),
            provenance=table.provenance,
        )
    except ModelFileError:
        raise
    except ValueError as error:
        raise ConfigurationError([f"{path.name}: {error}"]) from None
    if table.id is not None and table.id != model.id:
        raise ModelFileError(
            f"{path.name}: its id {table.id} is not that of its content {model.id}: it was edited; "
            "remove the id line to use it all the same"
        )
    check_vehicle(model, vehicle_id, path.name)
    return model


def check_vehicle(model: Model, vehicle_id: str | None, name: str) -> None:
    """Raise ModelFileError, which calls the model `name`, if it is of another vehicle. None: any vehicle."""
    if vehicle_id is not None and model.vehicle_id != vehicle_id:
        raise ModelFileError(
            f"{name}: is of vehicle {model.vehicle_name} ({model.vehicle_id}), not of {vehicle_id}; "
            "trace or learn with this vehicle's flights"
        )


def _plain(table: Strict) -> dict[str, Any]:
    return {name: getattr(table, name) for name in type(table).model_fields}


def _read_network(path: Path, table: _NetworkTable) -> Network:
    """Return the network with the weights in the model file's folder."""
    if Path(table.file).name != table.file:
        raise ModelFileError(f"{path.name}: network.file {table.file!r} must be a name in the same folder")
    weights = path.with_name(file_name(table.file))
    layout = Layout(hidden=table.hidden, frame=table.frame)
    try:
        xi = _read_weights(weights, layout.size)
    except FileNotFoundError:
        raise ModelFileError(
            f"{weights}: missing, put the weights of {path.name} back beside it or learn it anew"
        ) from None
    except bounds.TooLarge as error:
        raise ModelFileError(f"{weights}: {error}") from None
    except (OSError, EOFError, KeyError, ValueError, NotImplementedError, *_ARCHIVE_ERRORS) as error:
        raise ModelFileError(
            f"{weights}: the weights of {path.name} cannot be read ({error}); learn it anew"
        ) from error
    try:
        network = Network(layout=layout, xi=xi)
    except ValueError as error:
        raise ModelFileError(
            f"{weights}: xi: {error}; put the weights of {path.name} back beside it or learn it anew"
        ) from None
    if network_digest(network) != table.sha256:
        raise ModelFileError(f"{table.file}: not the weights {path.name} was written with")
    return network


_ARCHIVE_ERRORS = (zipfile.BadZipFile, zlib.error, RuntimeError)


def _read_weights(path: Path, count: int) -> np.ndarray:
    """Return the array `xi` of an archive that numpy wrote, read no further than `count` weights need.

    Sizes that the archive and the array declare may be false, so they decide nothing. Raises ModelFileError,
    TooLarge, OSError, EOFError, KeyError, ValueError, NotImplementedError or _ARCHIVE_ERRORS.
    """
    archive = zipfile.ZipFile(BytesIO(bounds.read_bounded(path, bounds.WEIGHTS_BYTES)))
    with archive.open("xi.npy") as stream:
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):
            raise ValueError(f"version {version[0]}.{version[1]} of the array's format")
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
        if shape != (count,) or dtype.kind != "f":
            raise ModelFileError(
                f"{path}: xi: {dtype} of shape {shape}, not {count} numbers; put the weights of the model "
                "back beside it or learn it anew"
            )
        content = stream.read(count * dtype.itemsize + 1)
    if len(content) != count * dtype.itemsize:
        raise ValueError(f"xi: another length than {count} numbers")
    return np.frombuffer(content, dtype).astype(float)

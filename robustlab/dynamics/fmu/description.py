"""What a unit says of itself: a zip archive with modelDescription.xml, both untrusted; read in the child process.

Nothing of the archive is written outside the given folder, sizes are checked before anything is unpacked, and a
document type declaration (the place of external entities and of entities that grow) is refused.
"""

from __future__ import annotations

import math
import stat
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree as ET

from robustlab.errors import InputError
from robustlab.files.signature import MIB

MODEL_EXCHANGE, CO_SIMULATION = "model-exchange", "co-simulation"
# An archive: bytes of all its files, their number, bytes of the description, variables in it.
MOST_BYTES, MOST_FILES, LARGEST_XML, MOST_VARIABLES = 2048 * MIB, 20_000, 32 * MIB, 200_000
XML = "modelDescription.xml"
# Vendor annotations that name joints: <Tool name="robustlab"> in FMI 2.0, <Annotation type="org.robustlab"> in 3.0.
OURS = ("robustlab", "org.robustlab")


class _Plain(ET.TreeBuilder):
    """Builds a tree of a document without document type declaration."""

    def doctype(self, *_: Any) -> None:
        raise InputError(XML, "a document type declaration, in which entities are declared", "none")


def read_description(path: str, shown: str) -> dict[str, Any]:
    """Plain types: version, name, token, states, inputs, outputs, parameters, joints, and what the unit can do.

    Raises InputError: no such archive, one that is truncated or larger than the limits, another version of FMI, signals
    that are arrays, clocks.
    """
    with _opened(path, shown) as archive:
        try:
            info = archive.getinfo(XML)
        except KeyError:
            raise InputError(shown, f"an archive without {XML}", "a functional mock-up unit (.fmu)") from None
        if info.file_size > LARGEST_XML:
            raise InputError(f"{shown}: {XML}", f"{info.file_size} bytes", f"at most {LARGEST_XML}")
        raw = _bytes(archive, info, shown)
    where = f"{shown}: {XML}"
    try:
        root = ET.fromstring(raw, ET.XMLParser(target=_Plain()))  # noqa: S314  entities are refused with the doctype
    except InputError as error:
        raise InputError(where, error.found, error.expected) from None
    except (ET.ParseError, ValueError, LookupError) as error:
        raise InputError(where, f"is no XML ({error})", "a description as of FMI 2.0 or 3.0") from None
    version = root.get("fmiVersion", "none")
    if root.tag != "fmiModelDescription" or not version.startswith(("2.", "3.")):
        found = f"FMI version {version[:20]}" if root.tag == "fmiModelDescription" else f"<{root.tag[:60]}>"
        raise InputError(where, found, "FMI 2.0 or 3.0", "export the unit anew as FMI 2.0")
    try:
        found = _Described(root, where, three=version.startswith("3.")).all()
    except ValueError as error:
        raise InputError(where, f"a number that is none ({error})", "a description as of FMI 2.0 or 3.0") from None
    return {"version": version, **found}


def unpack(path: str, shown: str, folder: str) -> None:
    """Unpack the archive into the folder.

    Raises InputError: a name that leads out of the folder, a link, an encrypted file; damaged data.
    """
    home = Path(folder)
    with _opened(path, shown) as archive:
        for info in archive.infolist():
            name = PurePosixPath(info.filename)
            if (
                name.is_absolute()
                or ".." in name.parts
                or any(ch in info.filename for ch in "\\:\0")
                or stat.S_ISLNK(info.external_attr >> 16)
            ):
                raise InputError(f"{shown}: {info.filename!r:.120}", "a name that can lead out of the archive", None)
            if info.is_dir():
                continue
            target = home / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(_bytes(archive, info, shown))


def _opened(path: str, shown: str) -> zipfile.ZipFile:
    try:
        archive = zipfile.ZipFile(path)
    except zipfile.BadZipFile as error:
        raise InputError(shown, f"is no whole zip archive ({error})", "a functional mock-up unit (.fmu)") from None
    except OSError as error:
        raise InputError(shown, f"cannot be read ({error.strerror})", "a functional mock-up unit (.fmu)") from None
    files = archive.infolist()
    size = sum(info.file_size for info in files)
    if len(files) > MOST_FILES or size > MOST_BYTES:
        archive.close()
        found = f"{len(files)} files of {size} bytes unpacked"
        raise InputError(shown, found, f"at most {MOST_FILES} files of {MOST_BYTES} bytes")
    return archive


def _bytes(archive: zipfile.ZipFile, info: zipfile.ZipInfo, shown: str) -> bytes:
    """One file; zipfile reads no more than the size that was declared, and checks the sum of it."""
    try:
        return archive.read(info)
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, NotImplementedError, OSError) as error:
        raise InputError(
            f"{shown}: {info.filename!r:.120}", f"cannot be unpacked ({error})", "a whole archive"
        ) from None


class _Described:
    """The description, read by the names of FMI 2.0 or 3.0."""

    def __init__(self, root: ET.Element, where: str, three: bool) -> None:
        self.root, self.where, self.three = root, where, three
        self.types = {t.get("name"): t for t in self._typed("TypeDefinitions")}
        self.variables = [self._variable(v) for v in root.find("ModelVariables") or ()]
        if len(self.variables) > MOST_VARIABLES:
            raise InputError(where, f"{len(self.variables)} variables", f"at most {MOST_VARIABLES}")
        self.by_reference: dict[int, dict[str, Any]] = {}
        for v in self.variables:
            if v["real"]:
                self.by_reference.setdefault(v["reference"], v)

    def all(self) -> dict[str, Any]:
        of = {kind: [v for v in self.variables if v["causality"] == kind] for kind in ("input", "output", "parameter")}
        states, rates = self._states()
        for v in (*of["input"], *of["output"], *states):
            if v["array"]:
                raise InputError(self.where, f"{v['name']} is an array", "scalar signals: export the unit with scalars")
        if any(v["kind"] == "Clock" for v in self.variables):
            raise InputError(self.where, "a unit with clocks", "one without: clocked partitions are not supported")
        outputs = [v for v in of["output"] if v["real"]]
        kinds = {kind: found for kind in (MODEL_EXCHANGE, CO_SIMULATION) if (found := self._kind(kind))}
        if not kinds:
            raise InputError(self.where, "neither model exchange nor co-simulation", "one of the two")
        return {
            "name": self.root.get("modelName", "unit"),
            "token": self.root.get("instantiationToken" if self.three else "guid", ""),
            "kinds": kinds,
            "states": [_kept(v, "nominal", "start") for v in states],
            "rates": [v["reference"] for v in rates],
            "inputs": [_kept(v, "start", "variability") for v in of["input"] if v["real"]],
            "outputs": [_kept(v, "variability") for v in outputs or states],
            "parameters": [
                _kept(v, "start", "meaning", "low")
                for v in of["parameter"]
                if v["real"] and v["variability"] in ("fixed", "tunable") and v["start"] is not None and not v["array"]
            ],
            "left_out": [v["name"] for side in ("input", "output") for v in of[side] if not v["real"]],
            "indicators": self._indicators(),
            "joints": [dict(j.attrib) for a in self._annotations() for j in a.iter("Joint")],
        }

    def _annotations(self) -> list[ET.Element]:
        if self.three:
            return [a for a in self.root.iterfind("Annotations/Annotation") if a.get("type") in OURS]
        return [a for a in self.root.iterfind("VendorAnnotations/Tool") if a.get("name") in OURS]

    def _typed(self, group: str) -> list[ET.Element]:
        return [t for t in self.root.find(group) or () if t.get("name") is not None]

    def _variable(self, element: ET.Element) -> dict[str, Any]:
        """One variable; what it does not state itself is taken from its declared type."""
        own = element if self.three else next((e for e in element if e.tag != "Annotations"), element)
        declared = self.types.get(own.get("declaredType"))
        base = declared if self.three or declared is None else next(iter(declared), None)

        def stated(key: str) -> str | None:
            value = own.get(key)
            return base.get(key) if value is None and base is not None else value

        kind = "Real" if own.tag == "Float64" else own.tag
        real = kind == "Real"
        reference = element.get("valueReference")
        if reference is None:
            raise InputError(self.where, f"variable {element.get('name')!r:.80} without value reference", None)
        start, array = own.get("start"), self.three and own.find("Dimension") is not None
        return {
            "name": element.get("name", ""),
            "reference": int(reference),
            "kind": kind,
            "real": real,
            "array": array,
            "causality": element.get("causality", "local"),
            "variability": element.get("variability", "continuous" if real else "discrete"),
            "unit": (stated("unit") or "").replace(".", " ").replace("*", " "),
            "start": float(start) if real and start and not array else None,
            "nominal": abs(float(stated("nominal") or 1.0)) or 1.0 if real else 1.0,
            "low": float(stated("min") or -math.inf) if real else -math.inf,
            "derivative": own.get("derivative"),
            "meaning": element.get("description", ""),
        }

    def _states(self) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """States and their rates, in the order of the model structure."""
        rates: list[dict[str, Any]] = []
        if self.three:
            for unknown in self.root.iterfind("ModelStructure/ContinuousStateDerivative"):
                rates.append(self._referred(unknown.get("valueReference")))
        else:
            for unknown in self.root.iterfind("ModelStructure/Derivatives/Unknown"):
                rates.append(self._numbered(unknown.get("index")))
        find = self._referred if self.three else self._numbered
        return [find(rate["derivative"]) for rate in rates], rates

    def _referred(self, reference: str | None) -> dict[str, Any]:
        found = None if reference is None else self.by_reference.get(int(reference))
        if found is None:
            raise InputError(self.where, f"the model structure names variable {reference}", "a real variable")
        return found

    def _numbered(self, index: str | None) -> dict[str, Any]:
        k = 0 if index is None else int(index)
        if not 1 <= k <= len(self.variables) or not self.variables[k - 1]["real"]:
            raise InputError(self.where, f"the model structure names variable number {index}", "a real variable")
        return self.variables[k - 1]

    def _indicators(self) -> int:
        if self.three:
            return sum(1 for _ in self.root.iterfind("ModelStructure/EventIndicator"))
        return max(int(self.root.get("numberOfEventIndicators", "0")), 0)

    def _kind(self, kind: str) -> dict[str, Any] | None:
        """What the unit says of one of the two interfaces; None where it has not got it."""
        element = self.root.find("ModelExchange" if kind == MODEL_EXCHANGE else "CoSimulation")
        if element is None:
            return None

        def can(name: str) -> bool:
            return element.get(name) in ("true", "1")

        identifier = element.get("modelIdentifier", "")
        if not identifier or any(ch in identifier for ch in "/\\:\0") or identifier.startswith("."):
            raise InputError(self.where, f"model identifier {identifier!r:.80}", "the name of a library")
        return {
            "identifier": identifier,
            "directional": can("providesDirectionalDerivatives" if self.three else "providesDirectionalDerivative"),
            "every_step_told": can("needsCompletedIntegratorStep")
            if self.three
            else not can("completedIntegratorStepNotNeeded"),
            "variable_step": can("canHandleVariableCommunicationStepSize"),
            "needs_tool": can("needsExecutionTool"),
        }


def _kept(variable: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    return {key: variable[key] for key in ("name", "unit", "reference", *keys)}

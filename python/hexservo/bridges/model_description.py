"""The file modelDescription.xml of a Functional Mock-up Unit: variables, units, structure."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree

from hexservo.scenario.scenario import Scenario
from hexservo.scenario.version import VERSION

_FMI2 = {"real": "Real", "whole": "Integer", "flag": "Boolean", "text": "String"}
_NONE, _ANY = {"dependencies": ""}, dict[str, str]()  # of an output: a tick is between; at first, all parameters
_FMI3 = {"real": "Float64", "whole": "Int32", "flag": "Boolean", "text": "String"}
_SI = {
    "m": {"m": 1},
    "s": {"s": 1},
    "kg": {"kg": 1},
    "rad": {"rad": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Hz": {"s": -1},
}
"""Units as products of powers of those that FMI has; pixels are not among them."""


@dataclass(frozen=True)
class UnitVariable:
    """One number or name of a unit; its value reference is its place in the list."""

    role: Literal["time", "parameter", "input", "output"]
    type: str  # real, whole, flag or text
    name: str  # for other tools
    source: str = ""  # key of the scenario or name of a signal, for the library
    index: int = 0  # in it
    unit: str = ""
    start: str = ""
    least: float | None = None
    most: float | None = None

    @property
    def line(self) -> str:
        """The variable's line in resources/model.txt."""
        if self.role == "time":
            return "time"
        start = f" {self.start}" if self.role == "input" else ""
        return f"{self.role} {self.type} {self.source} {self.index}{start}"


def model_description(
    scenario: Scenario, fmi: Literal[2, 3], what: str, identifier: str, token: str, variables: Sequence[UnitVariable]
) -> bytes:
    """Return modelDescription.xml of a unit for co-simulation.

    Parameters
    ----------
    scenario
        Its name, description, step and duration are written.
    fmi
        Version of the standard.
    what
        What the unit is, in a word.
    identifier
        Name of the shared object without its ending.
    token
        What the shared object is asked for an instance with.
    variables
        In the order of their value references, from 0.
    """
    described = f"{what} of the scenario {scenario.name}"
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion=f"{fmi}.0",
        modelName=scenario.name,
        description=described + (f": {scenario.description}" if scenario.description else ""),
        version=VERSION,
        generationTool=f"hexservo {VERSION}",
        variableNamingConvention="structured",
    )
    root.set("guid" if fmi == 2 else "instantiationToken", token)
    step, duration = float(scenario.simulation.step), float(scenario.simulation.duration)
    simulation = ElementTree.SubElement(
        root, "CoSimulation", modelIdentifier=identifier, canHandleVariableCommunicationStepSize="true"
    )
    if fmi == 3:
        simulation.set("fixedInternalStepSize", repr(step))
    _define_units(root, variables)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0.0", stopTime=repr(duration), stepSize=repr(step))
    (_variables2 if fmi == 2 else _variables3)(root, variables)
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def si_exponents(unit: str) -> dict[str, int] | None:
    """Return the exponents of kg, m, s and rad in a unit such as "N m/px^2"; None for one that has pixels.

    Examples
    --------
    >>> si_exponents("N/s")
    {'kg': 1, 'm': 1, 's': -3}
    """
    try:
        tree = ast.parse(unit.replace("^", "**").replace(" ", "*"), mode="eval")
        exponents = _exponents(tree.body)
    except (SyntaxError, KeyError):  # no product of powers, or one of other units
        return None
    return {base: power for base, power in exponents.items() if power}


def _exponents(product: ast.expr) -> Counter[str]:
    match product:
        case ast.Name(id=name):
            return Counter(_SI[name])
        case ast.Constant(value=1):
            return Counter()
        case ast.BinOp(left=base, op=ast.Pow(), right=ast.Constant(value=int(power))):
            return Counter({name: power * exponent for name, exponent in _exponents(base).items()})
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as operator, right=right):
            found, sign = _exponents(left), 1 if isinstance(operator, ast.Mult) else -1
            for name, exponent in _exponents(right).items():
                found[name] += sign * exponent
            return found
    raise KeyError(ast.unparse(product))


def _define_units(root: ElementTree.Element, variables: Sequence[UnitVariable]) -> None:
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in sorted({variable.unit for variable in variables if variable.unit and variable.type == "real"}):
        entry = ElementTree.SubElement(units, "Unit", name=unit)
        exponents = si_exponents(unit)
        if exponents is not None:
            ElementTree.SubElement(entry, "BaseUnit", {base: str(power) for base, power in exponents.items()})


def _attributes(variable: UnitVariable) -> tuple[dict[str, str], dict[str, str]]:
    """Return the attributes of every variable, and those of its values."""
    if variable.role == "time":
        causality, variability = "independent", "continuous"
    elif variable.role == "parameter":
        causality, variability = "parameter", "fixed"
    else:
        causality, variability = variable.role, "continuous" if variable.type == "real" else "discrete"
    values: dict[str, str] = {}
    if variable.unit and variable.type == "real":
        values["unit"] = variable.unit
    if variable.type in ("real", "whole"):
        for name, bound in (("min", variable.least), ("max", variable.most)):
            if bound is not None:
                values[name] = repr(float(bound)) if variable.type == "real" else str(round(bound))
    if variable.role in ("parameter", "input"):
        values["start"] = {"0": "false", "1": "true"}[variable.start] if variable.type == "flag" else variable.start
    return {"causality": causality, "variability": variability}, values


def _variables2(root: ElementTree.Element, variables: Sequence[UnitVariable]) -> None:
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        common, values = _attributes(variable)
        entry = ElementTree.SubElement(
            listed, "ScalarVariable", {"name": variable.name, "valueReference": str(reference), **common}
        )
        ElementTree.SubElement(entry, _FMI2[variable.type], values)
    structure = ElementTree.SubElement(root, "ModelStructure")
    for name, others in (("Outputs", _NONE), ("InitialUnknowns", _ANY)):
        block = ElementTree.SubElement(structure, name)
        for index, variable in enumerate(variables, 1):
            if variable.role == "output":
                ElementTree.SubElement(block, "Unknown", {"index": str(index), **others})


def _variables3(root: ElementTree.Element, variables: Sequence[UnitVariable]) -> None:
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        common, values = _attributes(variable)
        start = values.pop("start", None) if variable.type == "text" else None
        entry = ElementTree.SubElement(
            listed, _FMI3[variable.type], {"name": variable.name, "valueReference": str(reference), **common, **values}
        )
        if start is not None:
            ElementTree.SubElement(entry, "Start", value=start)
    structure = ElementTree.SubElement(root, "ModelStructure")
    for name, others in (("Output", _NONE), ("InitialUnknown", _ANY)):
        for reference, variable in enumerate(variables):
            if variable.role == "output":
                ElementTree.SubElement(structure, name, {"valueReference": str(reference), **others})

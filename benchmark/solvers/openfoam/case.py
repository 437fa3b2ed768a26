"""A fire for fireFoam: its mesh, and the dictionaries of one OpenFOAM case.

World axes are ours (Z up, metres), so nothing is turned on the way back. The mesh is one block of rectangular cells:
uniform in the core, where the flame is and what is handed over, and growing outwards to the domain's walls.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from gof.core.errors import DataFormatError
from gof_benchmark.solvers.openfoam import chemistry
from gof_benchmark.solvers.openfoam.chemistry import AMBIENT_K, AMBIENT_PA, OXYGEN_IN_AIR, Hydrocarbon
from gof_benchmark.solvers.openfoam.dictionaries import named, render, unnamed, write_dictionary
from gof_benchmark.solvers.openfoam.foam_fire import FoamBurner, FoamFire, Vector

GRAVITY = 9.81
SIDES = {"west": (-1, 0), "east": (1, 0), "south": (0, -1), "north": (0, 1)}  # outward normals


def write_case(fire: FoamFire, folder: Path, level: Literal["coarse", "fine"]) -> None:
    """Write the dictionaries of a case, all but its fields (`write_fields`) and its clock (`write_control`).

    Raises:
        DataFormatError: the mesh's cells are too large for a burner.
    """
    for i, area in enumerate(burner_areas(fire, level)):
        if not 0.75 < area / fire.burners[i].area_m2 < (1.33 if level == "fine" else 5):
            raise DataFormatError(
                f"fire '{fire.name}': burner {i} of {fire.burners[i].area_m2:.2e} m2 covers cells of {area:.2e} m2 "
                f"on the {level} mesh; choose cell_m (or coarse) so that its edges fall on faces"
            )
    system, constant = folder / "system", folder / "constant"
    write_dictionary(system / "blockMeshDict", block_mesh(fire, level))
    write_dictionary(system / "topoSetDict", {"actions": unnamed([_burner_faces(fire, i) for i in _each(fire)])})
    patches = [
        {
            "name": f"burner{i}",
            "patchInfo": {"type": "patch"},
            "constructFrom": "set",
            "set": f"burner{i}",
        }
        for i in _each(fire)
    ]
    write_dictionary(system / "createPatchDict", {"pointSync": False, "patches": unnamed(patches)})
    write_dictionary(system / "fvSchemes", schemes(fire))
    write_dictionary(system / "fvSolution", solution())
    for name, entries in constants(fire).items():
        write_dictionary(constant / name, entries)
    for name, dimensions, kind, value in (
        ("g", (0, 1, -2, 0, 0, 0, 0), "Vector", (0, 0, -GRAVITY)),
        ("pRef", (1, -1, -2, 0, 0, 0, 0), "Scalar", AMBIENT_PA),
        ("hRef", (0, 1, 0, 0, 0, 0, 0), "Scalar", fire.domain_high_m[2]),
    ):
        kind = f"uniformDimensioned{kind}Field"
        write_dictionary(constant / name, {"dimensions": f"[{' '.join(map(str, dimensions))}]", "value": value}, kind)


def block_mesh(fire: FoamFire, level: Literal["coarse", "fine"]) -> dict[str, Any]:
    """Return one block; its faces are the floor, the top and the four sides."""
    (x0, y0, z0), (x1, y1, z1) = fire.domain_low_m, fire.domain_high_m
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    axes = fire.axes(level)
    grading = " ".join(f"({' '.join(render(section) for section in axis)})" for axis in axes)
    faces = {
        "floor": (0, 3, 2, 1),
        "top": (4, 5, 6, 7),
        "west": (0, 4, 7, 3),
        "east": (1, 2, 6, 5),
        "south": (0, 1, 5, 4),
        "north": (3, 7, 6, 2),
    }
    return {
        "scale": 1,
        "vertices": [(x, y, z) for z in (z0, z1) for x, y in corners],
        "blocks": f"(hex (0 1 2 3 4 5 6 7) {render(fire.cells(level))} simpleGrading ({grading}))",
        "edges": (),
        "boundary": named({name: {"type": "patch", "faces": (face,)} for name, face in faces.items()}),
        "mergePatchPairs": (),
    }


def _each(fire: FoamFire) -> range:
    return range(len(fire.burners))


def _burner_faces(fire: FoamFire, i: int) -> dict[str, Any]:
    """Return a set of the floor's faces whose centre lies on the burner; a circle becomes a staircase, its mass flow
    stays."""
    burner = fire.burners[i]
    (x, y), half = burner.center_m, _reach(burner)
    thin = 0.1 * fire.cell_m[2]
    common = {"name": f"burner{i}", "type": "faceSet", "action": "new"}
    if burner.shape == "round":
        return common | {"source": "cylinderToFace", "p1": (x, y, -thin), "p2": (x, y, thin), "radius": half}
    return common | {"source": "boxToFace", "box": f"({x - half} {y - half} {-thin}) ({x + half} {y + half} {thin})"}


def _reach(burner: FoamBurner) -> float:
    """Half its size, m; a little more, so that faces centred on its edge belong to it whatever the rounding."""
    return burner.size_m / 2 * (1 + 1e-6)


def burner_areas(fire: FoamFire, level: Literal["coarse", "fine"]) -> list[float]:
    """m2 of the floor's faces that each burner will get, by the same rule."""
    ex, ey, _ = edges(fire, level)
    x, y = np.meshgrid((ex[1:] + ex[:-1]) / 2, (ey[1:] + ey[:-1]) / 2, indexing="ij")
    faces = np.outer(np.diff(ex), np.diff(ey))
    areas = []
    for burner in fire.burners:
        away = np.abs(np.stack([x, y], -1) - burner.center_m)
        distance = np.linalg.norm(away, axis=-1) if burner.shape == "round" else away.max(-1)
        areas.append(float(faces[distance <= _reach(burner)].sum()))
    return areas


def constants(fire: FoamFire) -> dict[str, dict[str, Any]]:
    """Return the gas and the way it burns, mixes and radiates: the files of `constant`."""
    gas = fire.gas
    return {
        "thermophysicalProperties": _thermophysical(gas),
        "reactions": chemistry.reactions(gas),
        "gases": chemistry.thermodynamics(gas),
        "chemistryProperties": {
            "chemistryType": {"solver": "noChemistrySolver"},
            "chemistry": "off",
            "initialChemicalTimeStep": 1e-7,
        },
        # Burning as fast as eddies (and, where they are weak, molecules) mix; constants as usual for pool fires.
        "combustionProperties": {
            "combustionModel": "EDM",
            "active": True,
            "EDMCoeffs": {"semiImplicit": False, "CEDC": 4, "Cd": 1},
        },
        "turbulenceProperties": {
            "simulationType": "LES",
            "LES": {
                "LESModel": fire.les_model,
                "turbulence": "on",
                "printCoeffs": "on",
                "delta": "cubeRootVol",
                "cubeRootVolCoeffs": {"deltaCoeff": 1},
                # As Smagorinsky's constant 0.10, usual in shear; the default (0.17) damps puffing on these meshes.
                "kEqnCoeffs": {"Ck": 0.05, "Ce": 1.048},
            },
        },
        "radiationProperties": _radiation(fire),
        "boundaryRadiationProperties": {'".*"': {"type": "lookup", "emissivity": 1.0, "transmissivity": 0.0}},
        # fireFoam can also rain, pyrolyse and wet walls; all of it is off.
        "additionalControls": {"solvePrimaryRegion": True},
        "reactingCloud1Properties": {"solution": {"active": False}},
        "surfaceFilmProperties": {"surfaceFilmModel": "none", "region": "none", "active": False},
        "pyrolysisZones": {
            "pyrolysis": {
                "active": False,
                "pyrolysisModel": "none",
                "region": "none",
                "infoOutput": False,
            }
        },
    }


def _thermophysical(gas: Hydrocarbon) -> dict[str, Any]:
    return {
        "thermoType": {
            "type": "hePsiThermo",
            "mixture": "singleStepReactingMixture",
            "transport": "sutherland",
            "thermo": "janaf",
            "energy": "sensibleEnthalpy",
            "equationOfState": "perfectGas",
            "specie": "specie",
        },
        "inertSpecie": "N2",
        "fuel": gas.species,
        "chemistryReader": "foamChemistryReader",
        "foamChemistryFile": '"<constant>/reactions"',
        "foamChemistryThermoFile": '"<constant>/gases"',
    }


def _radiation(fire: FoamFire) -> dict[str, Any]:
    return {
        "radiation": "on",
        "radiationModel": "fvDOM",
        "fvDOMCoeffs": {"nPhi": 2, "nTheta": 2, "maxIter": 1, "tolerance": 0.1},
        "solverFreq": 20,
        "absorptionEmissionModel": "greyMeanAbsorptionEmission",
        "greyMeanAbsorptionEmissionCoeffs": {
            "lookUpTableFileName": "none",
            "EhrrCoeff": fire.radiating_share,
        }
        | chemistry.absorption(fire.gas),
        "scatterModel": "none",
        "sootModel": "none",
        "transmissivityModel": "none",
    }


def schemes(fire: FoamFire) -> dict[str, Any]:
    """Second order in space (bounded where it must be), first order in time, as the Courant number is small."""
    bounded = {name: "limitedLinear01 1" for name in chemistry.species_of(fire.gas)} | {"h": "limitedLinear 1"}
    transport = "Gauss multivariateSelection\n" + render(bounded, 1).rstrip()
    return {
        "ddtSchemes": {"default": "Euler"},
        "gradSchemes": {"default": "Gauss linear"},
        "divSchemes": {
            "default": "none",
            "div(phi,U)": "Gauss LUST grad(U)",
            "div(phi,K)": "Gauss linear",
            "div(phi,k)": "Gauss limitedLinear 1",
            "div(phi,Yi_h)": transport,
            "div(((rho*nuEff)*dev2(T(grad(U)))))": "Gauss linear",
            "div(Ji,Ii_h)": "Gauss upwind",
        },
        "laplacianSchemes": {"default": "Gauss linear corrected"},
        "interpolationSchemes": {"default": "linear"},
        "snGradSchemes": {"default": "corrected"},
    }


def solution() -> dict[str, Any]:
    """Linear solvers and the pressure-velocity loop."""
    pressure = {"solver": "GAMG", "smoother": "DICGaussSeidel", "tolerance": 1e-6, "relTol": 0.05}
    transport = {"solver": "PBiCGStab", "preconditioner": "DILU", "tolerance": 1e-6, "relTol": 0.1}
    return {
        "solvers": {
            '"rho.*"': {"solver": "PCG", "preconditioner": "DIC", "tolerance": 1e-6, "relTol": 0},
            '"p(h)?_rgh"': pressure,
            "p_rghFinal": pressure | {"relTol": 0.005},
            '"(U|Yi|k|h)"': transport,
            '"(U|Yi|k|h)Final"': transport | {"relTol": 0},
            "Ii": {
                "solver": "GAMG",
                "smoother": "symGaussSeidel",
                "tolerance": 1e-4,
                "relTol": 0,
                "maxIter": 1,
                "nPostSweeps": 1,
            },
        },
        "PIMPLE": {
            "momentumPredictor": True,
            "nOuterCorrectors": 1,
            "nCorrectors": 2,
            "nNonOrthogonalCorrectors": 0,
            "hydrostaticInitialization": True,
            "nHydrostaticCorrectors": 5,
        },
        "relaxationFactors": {"equations": {'".*"': 1}},
    }


def write_control(folder: Path, fire: FoamFire, end_s: float, write_every_s: float, keep: int = 0) -> None:
    """Write `system/controlDict`: go on from the latest time to `end_s`, writing all fields every `write_every_s`.

    Args:
        keep: how many written times stay on disk, 0 = all.
    """
    often = {"writeControl": "timeStep", "writeInterval": 2, "log": False}
    functions = {
        "risePoints": {
            "type": "probes",
            "libs": '("libsampling.so")',
            "fields": "(U)",
            "probeLocations": probe_points(fire),
        }
        | often,
        "heatRelease": {
            "type": "volFieldValue",
            "libs": '("libfieldFunctionObjects.so")',
            "fields": "(Qdot)",
            "operation": "volIntegrate",
            "regionType": "all",
            "writeFields": False,
        }
        | often,
    }
    write_dictionary(
        folder / "system" / "controlDict",
        {
            "application": "fireFoam",
            "startFrom": "latestTime",
            "startTime": 0,
            "stopAt": "endTime",
            "endTime": end_s,
            "deltaT": 2e-4,
            "adjustTimeStep": True,
            "maxCo": fire.courant,
            "maxDeltaT": 0.004,
            "writeControl": "adjustableRunTime",
            "writeInterval": write_every_s,
            "purgeWrite": keep,
            "writeFormat": "binary",
            "writePrecision": 10,
            "writeCompression": "off",
            "timeFormat": "general",
            "timePrecision": 8,
            "runTimeModifiable": False,
            "functions": functions,
        },
    )


def probe_points(fire: FoamFire) -> list[Vector]:
    """Return points above the first burner at which the vertical speed is recorded: from a quarter of its size up."""
    burner, (dx, dy, dz) = fire.burners[0], fire.cell_m
    size = max(burner.size_m, 4 * dz)
    heights = [z for z in size * np.array([0.25, 0.5, 0.75, 1, 1.5, 2, 3]) if z < fire.core_high_m[2] - dz]
    # A little off the mesh's symmetry plane: on it a probe would sit on a face between two cells.
    return [(burner.center_m[0] + 0.1 * dx, burner.center_m[1] + 0.1 * dy, round(float(z), 6)) for z in heights]


def write_fields(fire: FoamFire, folder: Path, level: Literal["coarse", "fine"]) -> None:
    """Write the fields at time 0: still air with a small draught, and what each boundary does."""
    gas = fire.gas
    rough = {"type": "inletOutlet", "inletValue": "$internalField", "value": "$internalField"}
    closed = {"type": "zeroGradient"}
    fixed = {"type": "fixedValue", "value": "$internalField"}
    calculated = {"type": "calculated", "value": "$internalField"}

    def scalar(name, dimensions, value, openings=rough, floor=closed, burner=fixed, upwind=fixed, walls=closed):
        boundary = _boundary(fire, openings, floor, [burner] * len(fire.burners), upwind, walls)
        _write_field(folder / "0" / name, "Scalar", dimensions, f"uniform {value:.8g}", boundary)

    def share(of_fuel: float) -> dict[str, Any]:
        """Composition at the burner such that convection and diffusion together carry the given mass of fuel."""
        return {
            "type": "totalFlowRateAdvectiveDiffusive",
            "phi": "phi",
            "rho": "rho",
            "massFluxFraction": of_fuel,
            "value": f"uniform {of_fuel:g}",
        }

    scalar(gas.species, "0 0 0 0", 0.0, burner=share(1.0))
    scalar("O2", "0 0 0 0", OXYGEN_IN_AIR, burner=share(0.0))
    scalar("N2", "0 0 0 0", 1 - OXYGEN_IN_AIR, *[calculated] * 5)
    scalar("Ydefault", "0 0 0 0", 0.0, burner=share(0.0))
    scalar("T", "0 0 0 1", AMBIENT_K)
    scalar("k", "0 2 -2 0", 1e-4)
    scalar("nut", "0 2 -1 0", 0.0, *[closed] * 5)
    scalar("alphat", "1 -1 -1 0", 0.0, *[closed] * 5)
    scalar("p", "1 -1 -2 0", AMBIENT_PA, *[calculated] * 5)
    flux = {"type": "fixedFluxPressure", "value": "$internalField"}
    windy = any(fire.wind_m_s)
    still = {"type": "prghTotalHydrostaticPressure", "p0": "uniform 0", "gamma": 1, "value": "$internalField"}
    # Wind leaves through the openings at the pressure it has; its own total pressure is not the still air's.
    scalar("p_rgh", "1 -1 -2 0", 0.0, fixed if windy else still, flux, flux, flux, flux)
    hydrostatic = _boundary(fire, flux, flux, [flux] * len(fire.burners), flux, flux) | {"top": fixed}
    _write_field(folder / "0" / "ph_rgh", "Scalar", "1 -1 -2 0", "uniform 0", hydrostatic)
    grey = {"type": "greyDiffusiveRadiation", "T": "T", "value": "uniform 0"}
    scalar("IDefault", "1 0 -3 0", 0.0, *[grey] * 5)

    wind = (*fire.wind_m_s, 0.0)
    flows = [{"type": "flowRateInletVelocity", "massFlowRate": b.mass_flow(gas), "rho": "rho", "rhoInlet": gas.density}
             | {"value": f"uniform (0 0 {b.speed(gas):.8g})"} for b in fire.burners]  # fmt: skip
    openings = {"type": "pressureInletOutletVelocity", "value": f"uniform {render(wind)}"}
    if windy:
        openings["tangentialVelocity"] = f"uniform {render(wind)}"
    upwind = {"type": "fixedValue", "value": f"uniform {render(wind)}"}
    boundary = _boundary(fire, openings, {"type": "noSlip"}, flows, upwind, {"type": "slip"})
    start = draught(fire, level) + np.array(wind)
    rows = "\n".join(f"({x:.6g} {y:.6g} {z:.6g})" for x, y, z in start)
    _write_field(
        folder / "0" / "U", "Vector", "0 1 -1 0", f"nonuniform List<vector> {len(start)}\n(\n{rows}\n)", boundary
    )


def _boundary(fire: FoamFire, openings, floor, burners, upwind, walls) -> dict[str, dict]:
    """Return the behaviour of each patch: with wind, the sides it comes from are inlets and the sides along it
    smooth walls."""
    found = {"top": openings, "floor": floor} | {f"burner{i}": burner for i, burner in enumerate(burners)}
    for name, normal in SIDES.items():
        out = float(np.dot(normal, fire.wind_m_s))
        found[name] = openings if out > 0 or not any(fire.wind_m_s) else upwind if out < 0 else walls
    return found


def _write_field(path: Path, kind: str, dimensions: str, internal: str, boundary: dict[str, dict]) -> None:
    entries = {"dimensions": f"[{dimensions} 0 0 0]", "internalField": internal, "boundaryField": boundary}
    write_dictionary(path, entries, f"vol{kind}Field")


def draught(fire: FoamFire, level: Literal["coarse", "fine"]) -> np.ndarray:
    """Return (cells, 3) m/s in OpenFOAM's order (x fastest): smooth random air of eddies of some 0.2 m, drawn by the
    seed."""
    from scipy.interpolate import RegularGridInterpolator

    low, high = np.array(fire.domain_low_m), np.array(fire.domain_high_m)
    shape = np.maximum(2, np.ceil((high - low) / 0.1).astype(int) + 1)
    noise = np.random.default_rng(fire.seed).normal(0, fire.draught_m_s, (*shape, 3))
    knots = [np.linspace(a, b, n) for a, b, n in zip(low, high, shape, strict=True)]
    centers = [(e[1:] + e[:-1]) / 2 for e in edges(fire, level)]
    places = np.stack(np.meshgrid(*centers, indexing="ij"), -1)
    return RegularGridInterpolator(knots, noise)(places).transpose(2, 1, 0, 3).reshape(-1, 3)


def edges(fire: FoamFire, level: Literal["coarse", "fine"]) -> list[np.ndarray]:
    """Per axis the positions (m) of the cells' faces, as blockMesh will place them."""
    found = []
    for low, sections in zip(fire.domain_low_m, fire.axes(level), strict=True):
        parts = [np.zeros(1)]
        for length, count, last_to_first in sections:
            sizes = np.geomspace(1, last_to_first, count)
            parts.append(parts[-1][-1] + np.cumsum(sizes) * length / sizes.sum())
        found.append(low + np.concatenate(parts))
    return found

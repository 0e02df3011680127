"""Model files of the package, parsed by Drake, and poses of Denavit and Hartenberg."""

import logging

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from forcectl.models import add_packages, models_folder


def parse(file: str, plant: MultibodyPlant, strict: bool = True) -> None:
    parser = Parser(plant)
    add_packages(parser.package_map())
    if strict:
        parser.SetStrictParsing()  # a warning becomes an exception
    parser.AddModels(models_folder() / file)


def loaded_without_a_warning(file: str, with_geometry: bool, caplog: pytest.LogCaptureFixture) -> MultibodyPlant:
    builder = DiagramBuilder()
    plant = AddMultibodyPlantSceneGraph(builder, 0.001)[0] if with_geometry else MultibodyPlant(0.001)
    with caplog.at_level(logging.WARNING, logger="drake"):
        parse(file, plant)
        plant.Finalize()
        if with_geometry:
            builder.Build().CreateDefaultContext()
    assert [record.message for record in caplog.records] == []
    return plant


def dh_transform(theta: float, a: float, d: float, alpha: float) -> np.ndarray:
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]])

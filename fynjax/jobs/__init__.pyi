from ._build import build as build
from ._calibrate import calibrate as calibrate
from ._calibrate import demo as demo
from ._calibrate import render as render
from ._fit_leaf import fit_leaf as fit_leaf
from ._information import information as information
from ._pattern import pattern as pattern
from ._plant import plant as plant
from ._posterior import posterior as posterior
from ._reflectance import reflectance as reflectance
from ._result import (
    ParameterSummary as ParameterSummary,
)
from ._result import (
    RunSummary as RunSummary,
)
from ._result import (
    StatisticSummary as StatisticSummary,
)
from ._sensitivity import sensitivity as sensitivity
from ._simulate import PRODUCTS as PRODUCTS
from ._simulate import simulate as simulate
from ._simulate_lidar import simulate_lidar as simulate_lidar
from ._terrain import terrain as terrain
from ._validate import ValidationData as ValidationData
from ._validate import validate as validate

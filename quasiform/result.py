from dataclasses import dataclass
import numpy as np
@dataclass
class State:
    travel: float
    x: np.ndarray
    force: float
    linear_solves: int
    measures: dict
@dataclass
class Result:
    scene: object
    states: list
    reason: str
    wall: float
    linear_solves: int
    linear_solver: str
    increments: int
    rescues: dict
    residual: float
    energy_balance: float
    negative_pivots: object

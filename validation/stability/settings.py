"""Settings of the stability map: one changed at a time from the default, and difficult pairs."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .scenes import CASES, Case

NAMED_SIZES = ("coarse", "default", "fine")


@dataclass(frozen=True)
class Setting:
    """How a scene is built and solved.

    Parameters
    ----------
    increment : float
        For a travel of 80 mm, mm; 0 if the program chooses. Scenes with another kind of travel
        take the same part of it.
    size : "coarse", "default" or "fine"
        Each is half of the one before.
    contact : float
        Factor on the stiffness of the sheet under a tool.
    friction : float
    convex : "on demand", "always" or "never"
    method : "newton" or "relaxation"
    perturbation : float
        Amplitude of the noise on the start of each increment, mm.
    seed : int
    estimate : bool
        Whether the program estimates the error too.
    """

    increment: float = 0.0
    size: str = "default"
    contact: float = 1.0
    friction: float = 0.157
    convex: str = "on demand"
    method: str = "newton"
    perturbation: float = 0.0
    seed: int = 0
    estimate: bool = False

    @property
    def problem(self) -> tuple[str, float, float]:
        """Identifies the problem: the same problem has the same solution."""
        return self.size, self.contact, self.friction

    def applies(self, case: Case) -> bool:
        """Whether it differs from the default for a scene."""
        return case.contact or (self.contact, self.friction) == (1.0, DEFAULT.friction)


DEFAULT = Setting(estimate=True)
_ONE = replace(DEFAULT, estimate=False)
NOISE = 0.01  # mm
RELAXED = "coarse"  # about a hundred times the work of Newton's method: coarse mesh, few increments
SETTINGS: dict[str, Setting] = {
    "default": DEFAULT,
    **{f"increment-{mm}": replace(_ONE, increment=float(mm)) for mm in (1, 2, 5, 10, 20)},
    "coarse": replace(DEFAULT, size="coarse"),
    "fine": replace(DEFAULT, size="fine"),
    "contact-0.1": replace(_ONE, contact=0.1),
    "contact-10": replace(_ONE, contact=10.0),
    "friction-0": replace(_ONE, friction=0.0),
    "friction-0.5": replace(_ONE, friction=0.5),
    "exact": replace(_ONE, convex="never"),
    "convex": replace(_ONE, convex="always"),
    "relaxation": replace(_ONE, method="relaxation", size=RELAXED, increment=20.0),
    "perturbed": replace(_ONE, perturbation=NOISE),
    "friction-0.5+increment-20": replace(_ONE, friction=0.5, increment=20.0),
    "contact-10+fine": replace(_ONE, contact=10.0, size="fine"),
    "perturbed+fine": replace(_ONE, perturbation=NOISE, size="fine"),
}
USUAL = 5.0  # mm: the largest increment where the program chooses
SEEDS = 5
SEEDED = ("sheared-sheet", "box-45")  # wrinkled: one of many states


@dataclass(frozen=True)
class Cell:
    """A scene with a setting."""

    scene: str
    setting: Setting

    @property
    def size(self) -> float:
        """Size of the mesh, mm."""
        return CASES[self.scene].sizes[NAMED_SIZES.index(self.setting.size)]


def cells(scenes: list[str], settings: list[str]) -> dict[tuple[str, str], Cell]:
    """Cells of the map by scene and name of the setting, as far as they apply."""
    return {
        (scene, name): Cell(scene, SETTINGS[name])
        for scene in scenes
        for name in settings
        if SETTINGS[name].applies(CASES[scene])
    }


def seeds(scenes: list[str]) -> list[Cell]:
    """Perturbed starts of the wrinkled scenes, one per seed."""
    return [
        Cell(scene, replace(_ONE, perturbation=NOISE, seed=seed))
        for scene in SEEDED
        if scene in scenes
        for seed in range(SEEDS)
    ]


def rechecks(setting: Setting) -> tuple[Setting, Setting]:
    """Solves of the same problem that check a certified cell if the map has none.

    From a perturbed start (or, if it had one, from none), and with half the increment.
    """
    plain = replace(setting, estimate=False, convex="on demand", method="newton", seed=0)
    return (
        replace(plain, perturbation=0.0 if setting.perturbation else NOISE),
        replace(plain, increment=0.5 * (setting.increment or USUAL)),
    )


def is_check(check: Setting, setting: Setting) -> bool:
    """Whether a solve is a check of another one: same problem, perturbed start or finer increment.

    A perturbed start is checked by an unperturbed one too.
    """
    if check.problem != setting.problem or check == setting:
        return False
    if bool(check.perturbation) != bool(setting.perturbation):
        return True
    return (check.increment or USUAL) < (setting.increment or USUAL)

"""Which hearts are for what: three sealed lists, written before anything was tuned on them.

The unit of a claim is the heart (Efron and Tibshirani 1993, ch. 8: resample what varies independently). What
is tuned is tuned on TUNING; limits, probabilities and bounds are fitted on THRESHOLD; figures that are stated
come from REPORTED alone. A limit that is changed after a look at reported hearts makes them tuning hearts:
new ones are named here then.
"""

from dataclasses import dataclass

from dvf_ig.core import InvalidInputError


@dataclass(frozen=True, slots=True)
class HeartList:
    """Hearts of one purpose.

    Attributes:
        name: as the command line names it.
        first_world: seeds of hearts of the first synthetic world.
        second_world: seeds of hearts of the second; it is never tuned on.
        patients: of `acdc-cine`, whose real cines are the MR.
    """

    name: str
    first_world: range
    second_world: range
    patients: tuple[str, ...]

    def of_world(self, world: str) -> range:
        """Seeds of the hearts of the "first" or the "second" world.

        Raises:
            InvalidInputError: the list has none there.
        """
        seeds = self.second_world if world == "second" else self.first_world
        if not seeds:
            raise InvalidInputError(
                f"the {self.name} list has no hearts of the {world} world, which is for reporting alone; "
                "take --list reported"
            )
        return seeds


TUNING = HeartList("tuning", range(1001, 1061), range(0), ("002", "003"))
THRESHOLD = HeartList("threshold", range(2001, 2201), range(0), ("008", "009"))
REPORTED = HeartList("reported", range(3181, 3301), range(4081, 4161), ("012", "016", "018"))
"""Hearts looked at before a table was fitted, or a rule chosen, are left behind: 3001 to 3060 until decision
0036, 3061 to 3120 until 0039 of sweeps, 3121 to 3180 until 0039 of gated volumes; of the second world 4001 to
4040 until 0038, 4041 to 4080 until 0039."""
HEART_LISTS = {chosen.name: chosen for chosen in (TUNING, THRESHOLD, REPORTED)}


def heart_list(name: str) -> HeartList:
    """The list of that name.

    Raises:
        InvalidInputError: there is none.
    """
    if name not in HEART_LISTS:
        raise InvalidInputError(f"there is no list of hearts '{name}'; choose from {', '.join(HEART_LISTS)}")
    return HEART_LISTS[name]

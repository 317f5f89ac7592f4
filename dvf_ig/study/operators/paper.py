"""What people did in Ren 2008: rows of Tables I, III and IV, and the figures of this study's conditions.

The rows count where the paper prints another mean. Table III: printed 42 s with the force and "55 % less",
its rows give 52.2 s and 44 %. Table IV: printed means 42.3, 71.3, 37.6 and 67.6 s, rows 42.3, 70.1, 37.6 and
65.8 s.
"""

import numpy as np

from dvf_ig.study.operators.closed_loop import HAPTICS, MONO, NO_HAPTICS, STEREO, TASKS

AUTOMATIC_MM, MANUAL_MM = 0.29, 0.25
"""Mean errors of tracking (Figs 14, 15)."""
WANTED_MM = 5.0
DEPTH_MM = np.array(
    [
        [[4.92, 0.20], [4.69, 1.26]],
        [[4.81, 0.78], [4.96, 1.75]],
        [[4.92, 0.27], [3.62, 1.24]],
        [[4.80, 0.11], [4.74, 1.45]],
        [[4.46, 0.22], [4.44, 2.03]],
        [[4.90, 0.10], [4.73, 1.34]],
    ]
)
"""Table I, (6 people, with and without force, mean and SD about it): depth of pellets pushed to WANTED_MM."""
DISSECTION_S = np.array(
    [
        [[15, 20, 30, 31, 37], [45, 55, 41, 39, 37]],
        [[30, 29, 22, 26, 145], [45, 44, 43, 45, 203]],
        [[47, 64, 190, 45, 35], [87, 126, 250, 109, 66]],
        [[75, 39, 36, 18, 28], [110, 176, 75, 51, 55]],
        [[86, 91, 78, 63, 26], [203, 190, 124, 82, 41]],
    ],
    dtype=np.float64,
)
"""Table III, (5 people, with and without force, 5 trials)."""
SIGHT_S = np.array(
    [
        [33.6, 64.8, 31.6, 53.4],
        [43.6, 42.2, 40.8, 57.6],
        [24.0, 42.2, 22.0, 43.6],
        [55.8, 159.4, 59.6, 70.2],
        [54.4, 41.8, 34.0, 104.0],
    ]
)
"""Table IV, (5 people, mono with and without force, stereo with and without)."""


def depth_rms_mm() -> tuple[float, float]:
    """RMS of the depth about WANTED_MM with and without force, mean over the people of Table I."""
    of_person = np.sqrt((DEPTH_MM[:, :, 0] - WANTED_MM) ** 2 + DEPTH_MM[:, :, 1] ** 2)
    with_it, without = of_person.mean(axis=0).tolist()
    return with_it, without


def figures_of(task: str) -> dict[str, str]:
    """What people did, by this study's condition; "–" where the paper has no such condition."""
    names = [condition.name for condition in TASKS[task]]
    if task == "lesion":
        return dict.fromkeys(names, "–")
    if task == "tracking":
        shown = dict.fromkeys(names, f"manual {MANUAL_MM:g} mm mean, condition not stated")
        return {**shown, "automatic": f"{AUTOMATIC_MM:g} mm mean"}
    if task == "cutting":
        arms = dict(zip((HAPTICS, NO_HAPTICS), DEPTH_MM.mean(axis=0).tolist(), strict=True))
        return {
            name: next(
                (f"{mean:.2f} ± {sd:.2f} mm" for end, (mean, sd) in arms.items() if name.endswith(end)), "–"
            )
            for name in names
        }
    columns = (
        f"{MONO}, {HAPTICS}",
        f"{MONO}, {NO_HAPTICS}",
        f"{STEREO}, {HAPTICS}",
        f"{STEREO}, {NO_HAPTICS}",
    )
    seconds = dict(zip(columns, SIGHT_S.mean(axis=0).tolist(), strict=True))
    with_s, without_s = DISSECTION_S.mean(axis=(0, 2)).tolist()
    table_iii = {columns[0]: f"; {with_s:.1f} s", columns[1]: f"; {without_s:.1f} s"}
    return {
        name: f"{seconds[name]:.1f} s{table_iii.get(name, '')}" if name in seconds else "–" for name in names
    }

"""Image pairs of a study as files that `config init --us-volume` takes, with their truth and starts."""

from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path

from data_synth.scenario.image_pair import VOLUME_VIEWS, ImagePair, PairSpec, image_pair
from dvf_ig.core import Landmarks, TrackedVolume
from dvf_ig.io import (
    output_folder,
    write_landmarks,
    write_model,
    write_timing,
    write_transform,
    write_volume,
    write_volume_series,
)
from dvf_ig.preop import model_from_preop
from dvf_ig.study.trials import Settings

from .experiments import trials_per_condition
from .problem import GATED, in_tracker, volume_problem
from .trial import trial_start


def keep_pairs(
    settings: Settings, numbers: Sequence[int], folder: Path, progress: Callable[[float], None]
) -> list[Path]:
    """Write the pairs that the trials of `study capture` worked on, each into a folder of its own.

    Args:
        settings: from `experiments.settings_of`; all images are gated volumes.
        numbers: of the trials; each adds start-NUMBER.tfm, the pose it began at, to its pair's folder.
        progress: told the share that is written.
    Returns:
        the folders, pair-SEED-MOTION-QUALITY.
    Raises:
        OutputError: not writable.
    """
    per_condition = trials_per_condition(settings)
    groups = sorted({number // per_condition for number in numbers})
    folders = []
    for done, group in enumerate(groups):
        seed, which = divmod(group, len(settings["conditions"]))
        condition = settings["conditions"][which]
        pair = image_pair(PairSpec(seed, condition["motion"], condition["quality"]))
        volumes = pair.volumes(GATED)
        place = folder / f"pair-{seed}-{condition['motion']}-{condition['quality']}"
        write_pair(pair, volumes, place)
        problem = volume_problem(pair, volumes)
        for number in numbers:
            if number // per_condition == group:
                write_transform(trial_start(settings, number, problem), place / f"start-{number}.tfm")
        folders.append(place)
        progress((done + 1) / len(groups))
    return folders


def write_pair(pair: ImagePair, volumes: Sequence[TrackedVolume], folder: Path) -> None:
    """Write the heart before and now into a folder.

    Before: model.npz; cine.nrrd with timing.json, and labels.nrrd of all its phases. Now: VIEW-PHASE.nrrd in
    the tracker's coordinates for each of VOLUME_VIEWS and GATED. Truth: truth.tfm, and the targets on both
    sides, targets_mr.mrk.json and targets_tracker.mrk.json.

    Args:
        volumes: of the pair, at GATED.
    Raises:
        OutputError: not writable.
    """
    mr, labels = pair.preop.mr, pair.preop.labels
    if mr is None or labels is None:
        raise TypeError("the phantom's pre-operative data hold MR and labels")
    with output_folder(folder):
        write_volume_series(mr, folder / "cine.nrrd")
        write_volume_series(labels, folder / "labels.nrrd")
        write_timing(mr.timing, folder / "timing.json")
        write_model(model_from_preop(pair.preop), folder / "model.npz")
        truth = pair.mr_from_tracker
        touched = Landmarks(pair.targets.names, truth.inverse().apply(pair.targets.points))
        write_landmarks(pair.targets, folder / "targets_mr.mrk.json")
        write_landmarks(touched, folder / "targets_tracker.mrk.json")
        write_transform(truth, folder / "truth.tfm")
        for (view, phase), volume in zip(product(VOLUME_VIEWS, GATED), volumes, strict=True):
            name = f"{view.replace(' ', '-')}-{phase:.2f}.nrrd"
            write_volume(in_tracker(volume.image, volume.tracker_from_image), folder / name)

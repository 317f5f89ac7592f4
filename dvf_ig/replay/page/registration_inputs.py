"""Inputs of a registration as its page shows them: gated frames, gated volumes, a pair of images."""

from collections.abc import Sequence

from dvf_ig.core import Scenario, TrackedVolume, Volume, VolumeSeries
from dvf_ig.registration import RegistrationResult
from dvf_ig.session import GatedFrames, Heart, UltrasoundRecording

from .planes import anatomy_of_heart, anatomy_of_image, frame_overlays
from .registration_page import ShownInput
from .volume_planes import image_overlays, tracked_overlays

TRACKER, PREOPERATIVE = "the tracker", "the pre-operative image"


def frames_shown(
    result: RegistrationResult,
    frames: GatedFrames,
    recording: UltrasoundRecording,
    scenario: Scenario,
) -> ShownInput:
    """Show the gated, tracked frames of a scenario."""
    heart, mr, name = recording.heart, scenario.preop.mr, scenario.name
    anatomy = anatomy_of_heart(heart, mr)
    gated = frames.gated
    return ShownInput(
        title=f"Registration of {name}",
        about=f"patient {heart.model.patient_id}",
        source_name=TRACKER,
        target_name=PREOPERATIVE,
        anatomy=anatomy.name,
        remark=anatomy.remark,
        planes=frame_overlays(
            frames,
            recording.images,
            recording.calibrations.probe_from_image,
            anatomy,
            result.start,
            result.target_from_source,
        ),
        data=[
            ("frames recorded", str(len(frames.event_s))),
            (
                "frames compared with the model",
                f"{len(frames.used)} of {len(gated.index)} that passed the gate",
            ),
            *((f"rejected: {reason}", str(count)) for reason, count in gated.rejected.items() if count),
            ("seen", f"{frames.event_s[frames.used[0]]:.1f} to {frames.event_s[frames.used[-1]]:.1f} s"),
            ("R peaks found", str(len(recording.peaks))),
            *_model_rows(heart),
        ],
        frames=len(frames.used),
        model=heart.model,
        frames_rejected={str(reason): count for reason, count in gated.rejected.items() if count},
        targets=scenario.landmarks_mr,
        tracked_against=scenario.tracked_against,
    )


def volumes_shown(
    result: RegistrationResult,
    volumes: Sequence[TrackedVolume],
    heart: Heart,
    mr: VolumeSeries | None,
    *,
    about: str = "",
) -> ShownInput:
    """Show gated 3-D volumes.

    Args:
        volumes: as they were registered.
        mr: pre-operative grey levels; None without any.
        about: from which files.
    """
    anatomy = anatomy_of_heart(heart, mr)
    phases = ", ".join(f"{100 * volume.model_phase:.0f} %" for volume in volumes)
    whose = f"patient {heart.model.patient_id}"
    return ShownInput(
        title="Registration of gated 3-D ultrasound",
        about=f"{whose}, {about}" if about else whose,
        source_name=TRACKER if result.target_from_source.source == "tracker" else "the ultrasound volumes",
        target_name=PREOPERATIVE,
        anatomy=anatomy.name,
        remark=anatomy.remark,
        planes=tracked_overlays(anatomy, volumes, result.start, result.target_from_source),
        data=[("volumes", str(len(volumes))), ("places in the cycle", phases), *_model_rows(heart)],
        model=heart.model,
    )


def pair_shown(result: RegistrationResult, ultrasound: Volume, anatomy: Volume, *, about: str) -> ShownInput:
    """Show a pair of images.

    Args:
        about: the files they come from.
    """
    return ShownInput(
        title="Registration of an image pair",
        about=about,
        source_name="the fixed image",
        target_name="the moving image",
        anatomy="moving image",
        remark="",
        planes=image_overlays(
            anatomy_of_image(anatomy, "moving image"), ultrasound, result.start, result.target_from_source
        ),
        data=[
            (f"{name} image", _size(image)) for name, image in (("fixed", ultrasound), ("moving", anatomy))
        ],
    )


def _model_rows(heart: Heart) -> list[tuple[str, str]]:
    model = heart.model
    return [("model", f"surface {model.surface_name}, {model.phases} phases")]


def _size(image: Volume) -> str:
    voxels, spacing = image.grid.shape, image.grid.spacing_mm
    return f"{' × '.join(map(str, voxels))} voxels of {' × '.join(f'{v:.2f}' for v in spacing)} mm"

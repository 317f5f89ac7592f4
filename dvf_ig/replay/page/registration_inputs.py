"""Input of a registration, as its page shows it: gated frames, gated volumes, a pair of images."""

from collections.abc import Sequence

from dvf_ig.core import Rigid, TrackedVolume, Volume, VolumeSeries, mean_displacement_mm
from dvf_ig.registration import RegistrationResult
from dvf_ig.replay.registration import Registration
from dvf_ig.session import Heart

from .planes import anatomy_of_heart, anatomy_of_image, frame_overlays
from .registration_page import RegisteredInput
from .volume_planes import image_overlays, tracked_overlays

TRACKER, PREOPERATIVE = "the tracker", "the pre-operative image"


def frames_shown(registration: Registration, name: str, mr: VolumeSeries | None) -> RegisteredInput:
    """Describe gated, tracked frames of a recording.

    Args:
        name: name of the recording.
        mr: pre-operative grey levels, if any.
    """
    result, frames, recording = registration.result, registration.frames, registration.recording
    heart = recording.heart
    anatomy = anatomy_of_heart(heart, mr)
    gated = frames.gated
    return RegisteredInput(
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
            registration.start,
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
        landmarks_mm=_apart_mm(result, registration.landmarks, heart),
        touched=registration.touched,
        frames=len(frames.used),
        model=heart.model,
        frames_rejected={str(reason): count for reason, count in gated.rejected.items() if count},
    )


def volumes_shown(
    result: RegistrationResult,
    start: Rigid,
    volumes: Sequence[TrackedVolume],
    heart: Heart,
    mr: VolumeSeries | None,
    *,
    landmarks: Rigid | None = None,
    about: str = "",
) -> RegisteredInput:
    """Describe gated 3-D volumes.

    Args:
        volumes: as they were registered.
        mr: pre-operative grey levels, if any.
        landmarks: mr_from_tracker from touched landmarks, if any.
        about: the files they come from.
    """
    anatomy = anatomy_of_heart(heart, mr)
    phases = ", ".join(f"{100 * volume.model_phase:.0f} %" for volume in volumes)
    whose = f"patient {heart.model.patient_id}"
    return RegisteredInput(
        title="Registration of gated 3-D ultrasound",
        about=f"{whose}, {about}" if about else whose,
        source_name=TRACKER if result.target_from_source.source == "tracker" else "the ultrasound volumes",
        target_name=PREOPERATIVE,
        anatomy=anatomy.name,
        remark=anatomy.remark,
        planes=tracked_overlays(anatomy, volumes, start, result.target_from_source),
        data=[("volumes", str(len(volumes))), ("phases of the cycle", phases), *_model_rows(heart)],
        landmarks_mm=_apart_mm(result, landmarks, heart),
        model=heart.model,
    )


def pair_shown(
    result: RegistrationResult, start: Rigid, ultrasound: Volume, anatomy: Volume, *, about: str
) -> RegisteredInput:
    """Describe a pair of images.

    Args:
        about: the files they come from.
    """
    return RegisteredInput(
        title="Registration of an image pair",
        about=about,
        source_name="the fixed image",
        target_name="the moving image",
        anatomy="moving image",
        remark="",
        planes=image_overlays(
            anatomy_of_image(anatomy, "moving image"), ultrasound, start, result.target_from_source
        ),
        data=[
            (f"{name} image", _size(image)) for name, image in (("fixed", ultrasound), ("moving", anatomy))
        ],
    )


def _apart_mm(result: RegistrationResult, landmarks: Rigid | None, heart: Heart) -> float | None:
    if landmarks is None:
        return None
    return mean_displacement_mm(result.target_from_source, landmarks, heart.center_mm)


def _model_rows(heart: Heart) -> list[tuple[str, str]]:
    model = heart.model
    return [("model", f"surface {model.surface_name}, {model.phases} phases")]


def _size(image: Volume) -> str:
    voxels, spacing = image.grid.shape, image.grid.spacing_mm
    return f"{' × '.join(map(str, voxels))} voxels of {' × '.join(f'{v:.2f}' for v in spacing)} mm"

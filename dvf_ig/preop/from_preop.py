"""The patient's model from the pre-operative data available."""

from dvf_ig.core import DvfModel, InvalidInputError, Preop, Progress
from dvf_ig.preop.motion.cycle import MotionOptions

from .build import ModelOptions, model_from_labels, model_from_surfaces
from .cine_model import CineOptions, model_from_cine


def model_from_preop(
    preop: Preop, *, options: ModelOptions | None = None, progress: Progress | None = None
) -> DvfModel:
    """Build the patient's model from the best pre-operative data available.

    Labels of every phase come first, then MR with labels of its end-diastole, then the surface named in the
    data.

    Args:
        options: options of the fit; None takes the defaults.
        progress: called with the fraction done.
    Raises:
        InvalidInputError: none of these, or data that `build_model` refuses.
    """
    options = options or ModelOptions()
    if preop.labels is not None:
        return model_from_labels(preop, options=options, progress=progress)
    if preop.ed_labels is not None:
        return _from_cine(preop, options, progress)
    by_name = {series.name: series for series in preop.surfaces}
    if preop.surface not in by_name:
        raise InvalidInputError(
            f"the pre-operative data of '{preop.patient_id}' give no model: needed a model file, labels of "
            f"every phase, MR with labels of its end-diastole, or a surface '{preop.surface}'; "
            f"surfaces given: {', '.join(by_name) or 'none'}"
        )
    others = [series for name, series in by_name.items() if name != preop.surface]
    return model_from_surfaces(by_name[preop.surface], others=others, options=options, progress=progress)


def _from_cine(preop: Preop, options: ModelOptions, progress: Progress | None) -> DvfModel:
    if preop.mr is None or preop.ed_labels is None:
        raise InvalidInputError(
            "labels of end-diastole alone give no motion; also give the 4-D image that they belong to (mr)"
        )
    cine = cine_options(preop, MotionOptions(threads=options.threads), options)
    return model_from_cine(
        preop.mr,
        preop.ed_labels,
        patient_id=preop.patient_id,
        views=preop.views,
        options=cine,
        progress=progress,
    ).model


def cine_options(preop: Preop, motion: MotionOptions, model: ModelOptions) -> CineOptions:
    """Collect the meaning of the labels of end-diastole and the options of motion and model."""
    return CineOptions(
        preop.organ_labels,
        preop.blood_labels,
        preop.ed_phase,
        preop.surface,
        motion,
        model,
        preop.label_names,
    )

"""The rig of tests that need one, but no special one."""

from typing import Any

from fringedic.rig.model import RigModel


def aligned_rig(
    camera: tuple[int, int], pixel_size: float, projector: tuple[int, int], focal_length: float, **values: Any
) -> RigModel:
    """Return a rig whose optical axes go through the middle of the images, without tilts, 0.4 m away.

    Sizes of the images are (width, height) [px]; `values` are other parameters of the model.
    """
    known = {
        "camera_distance": 0.4,
        "projector_position": (0.18, 0.0, 0.38),
        "pixel_aspect": 1.0,
        "principal_column": (camera[0] - 1) / 2,
        "principal_row": (camera[1] - 1) / 2,
        "projector_principal_column": (projector[0] - 1) / 2,
        "projector_principal_row": (projector[1] - 1) / 2,
    }
    return RigModel(
        camera_width=camera[0],
        camera_height=camera[1],
        pixel_size=pixel_size,
        projector_width=projector[0],
        projector_height=projector[1],
        projector_focal_length=focal_length,
        **{**known, **values},
    )

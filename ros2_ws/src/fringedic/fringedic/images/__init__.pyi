from .image_series import ImageSeries as ImageSeries
from .image_series import MeasuredImage as MeasuredImage
from .image_series import measure_images as measure_images
from .phase_images import measure_phase_images as measure_phase_images

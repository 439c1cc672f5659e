"""Random pairs of images with an exactly known displacement, rendered without any code of the library.

`textures` contains the surfaces, evaluated at any material point, `motions` maps with exact inverses, `layers` the
camera, which composes surfaces that cover each other, and `scenes` draws a scene from its number.
"""

"""Random pairs of images with an exactly known displacement, rendered without any code of the library, and measured.

`textures` contains the surfaces, evaluated at any material point, `motions` maps with exact inverses, `layers` the
camera, which composes surfaces that cover each other. `scenes` draws a scene from its number, `outcomes`
measures it and compares the result with the truth.
"""

"""Image processing of a consumer camera between its sensor and the viewer: one module for each step.

In this order, each off at its neutral value:

1. `mosaic`: the sensor's colour filters. Noise enters before, at each pixel of the mosaic.
2. `mosaic`: demosaicing, by which each pixel gets the two colours that its filter did not let through.
3. `tone`: gamma and contrast curve, for each colour; then the luma, which is all that a grey image keeps.
4. `smoothing`: denoising, then sharpening, of the luma.
5. Rounding to 8 bits, a JPEG and back, and `video_stream`: an H.264 video and back.

The scene is grey. White balance therefore makes all colours equal apart from their noise. `development` puts
the first four together. `skyherd.render.sensor` does the steps before them, light, gain and noise, and the
codecs.
"""

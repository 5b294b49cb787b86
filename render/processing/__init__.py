"""Image processing pipeline of a consumer camera.

The steps, in this order; each is off at its neutral value:

1. `mosaic`: colour filter array. Noise enters before it, at each pixel of the mosaic.
2. `mosaic`: demosaicing, which interpolates the two missing colours of each pixel.
3. `tone`: gamma and contrast curve of each colour, then the luma.
4. `smoothing`: denoising, then sharpening, of the luma.
5. Rounding to 8 bits, JPEG compression, and `video_stream`: H.264 compression.

The scene is grey, so that after white balance the colours differ only by noise. `development` combines the
first four steps. `skyherd.render.sensor` models light, gain and noise before them, and the codecs after them.
"""

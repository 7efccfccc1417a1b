"""Films from frames: GIF by Pillow, MP4 by the program ffmpeg, that of the system or the one that comes with imageio-ffmpeg."""

import contextlib
import shutil
import subprocess
import tempfile

from pmpm.output.files import OutputError, one_line, unfinished_name

FRAMES_PER_SECOND = 15
MP4_NEEDS = "MP4 needs the program ffmpeg (pip install 'pmpm[viz]', or Debian: apt install ffmpeg); GIF needs nothing"


def ffmpeg():
    """Path of the program, None where there is none."""
    found = shutil.which("ffmpeg")
    if found is None:
        with contextlib.suppress(ImportError, RuntimeError):
            import imageio_ffmpeg

            found = imageio_ffmpeg.get_ffmpeg_exe()
    return found


def check(file):
    """Raise OutputError for a film that nobody can make here, before its frames are drawn."""
    if file.suffix.lower() == ".mp4" and ffmpeg() is None:
        raise OutputError(f"--out {file}: {MP4_NEEDS}")


def write(file, frames):
    """Write frames, (height, width, 3) bytes each and all alike, as the film that the file's name says, whole or not at all."""
    unfinished = unfinished_name(file).with_suffix(file.suffix)
    try:
        (write_mp4 if file.suffix.lower() == ".mp4" else write_gif)(unfinished, iter(frames))
        unfinished.replace(file)
    finally:
        unfinished.unlink(missing_ok=True)


def write_gif(file, frames):
    from PIL import Image

    def colours(frame):
        return Image.fromarray(frame).quantize(256, dither=Image.Dither.NONE)

    first = colours(next(frames))
    first.save(
        file, format="GIF", save_all=True, append_images=map(colours, frames), duration=1000 / FRAMES_PER_SECOND, loop=0
    )


def write_mp4(file, frames):
    first = next(frames)
    height, width = first.shape[:2]
    command = [
        ffmpeg(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", str(FRAMES_PER_SECOND), "-i", "-", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white", "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", str(file),
    ]  # fmt: skip
    with tempfile.TemporaryFile() as told:  # a pipe that nobody reads would fill
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=told)
        assert process.stdin is not None
        try:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.write(first.tobytes())
                for frame in frames:
                    process.stdin.write(frame.tobytes())
        finally:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
            status = process.wait()
        if status != 0:
            told.seek(0)
            raise OutputError(f"--out {file}: ffmpeg failed: {one_line(told.read().decode(errors='replace'))}")

"""Make the pictures of a page anew: ``python docs/pictures.py docs/start/plate.md ...``.

The blocks of the page are run as `tests/docs/page_blocks.py` does; each picture that has a comment
``<!-- test: picture FILE -->`` before it is FILE as they wrote it, made smaller.
"""

import sys
import tempfile
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "docs"))

from page_blocks import run_page

WIDTH, COLOURS = 1200, 256


def small(source: Path, target: Path) -> None:
    """Write a picture of at most `WIDTH` pixels across, in few colours."""
    with Image.open(source) as picture:
        picture = picture.convert("RGB")
        if picture.width > WIDTH:
            height = round(picture.height * WIDTH / picture.width)
            picture = picture.resize((WIDTH, height), Image.Resampling.LANCZOS)
        target.parent.mkdir(exist_ok=True)
        few = picture.quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        few.save(target, optimize=True)


def main(pages: list[str]) -> None:
    """Run the pages and write their pictures."""
    for page in map(Path, pages):
        with tempfile.TemporaryDirectory() as folder:
            for target, source in run_page(page.resolve(), Path(folder)).items():
                small(source, page.parent / target)
                size = (page.parent / target).stat().st_size
                print(f"{page.parent / target}: {size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])

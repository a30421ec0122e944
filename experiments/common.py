"""What every experiment shares: its two options, and where its data and picture go."""

import argparse
from pathlib import Path

from traffic_road.plots import save_figure
from traffic_road.store import save


def options(doc: str) -> argparse.Namespace:
    """--quick: the same at a size that takes seconds; --output: the folder for NAME.nc and NAME.png."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a small version, for the tests")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "figures", metavar="FOLDER")
    return parser.parse_args()


def store(name: str, folder: Path, ds, figure) -> None:
    """Write FOLDER/NAME.nc and FOLDER/NAME.png."""
    folder.mkdir(parents=True, exist_ok=True)
    save(ds, folder / f"{name}.nc")
    save_figure(figure, folder / f"{name}.png")
    print(f"wrote {folder / name}.nc and .png")

"""What every experiment shares: its two options, and where its data and picture go."""

import argparse
import re
from pathlib import Path

from traffic_road.plots import save_figure
from traffic_road.store import origin, save


def options(doc: str) -> argparse.Namespace:
    """--quick: the same at a size that takes seconds; --output: the folder for NAME.nc and NAME.png."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a small version, for the tests")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "figures", metavar="FOLDER")
    return parser.parse_args()


def store(name: str, folder: Path, ds, figure) -> None:
    """Write FOLDER/NAME.nc, in CF's names (0.9 in a name becomes 0_9) and with where it comes from, and FOLDER/NAME.png."""
    folder.mkdir(parents=True, exist_ok=True)
    stored = ds.rename({n: _name(n) for n in {*ds.variables, *ds.dims} if n != _name(n)})
    stored.attrs = origin() | {_name(n): value for n, value in ds.attrs.items()}
    save(stored, folder / f"{name}.nc")
    save_figure(figure, folder / f"{name}.png")
    print(f"wrote {folder / name}.nc and .png")


def _name(name: str) -> str:
    return re.sub(r"\W", "_", name.replace("+", ""))

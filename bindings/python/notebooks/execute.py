"""Executes the notebooks, each in its folder; with --write keeps what they print and draw.

    python execute.py [--write] [NOTEBOOK...]
"""

import argparse
import re
from pathlib import Path

import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).resolve().parent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="keep outputs and pictures in the files")
    parser.add_argument("notebooks", nargs="*", type=Path, default=sorted(HERE.glob("*.ipynb")))
    arguments = parser.parse_args()
    for path in arguments.notebooks:
        notebook = nbformat.read(path, as_version=4)
        NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": str(HERE)}}).execute()
        if arguments.write:
            for cell in notebook.cells:
                cell.metadata.pop("execution", None)
                for output in cell.get("outputs", []):
                    # Addresses differ from run to run.
                    if "text/plain" in output.get("data", {}):
                        text = output["data"]["text/plain"]
                        output["data"]["text/plain"] = re.sub(r" at 0x[0-9a-f]+", "", text)
            nbformat.write(notebook, path)
        print(f"{path.name}: runs")


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: Apache-2.0
"""Runs the cells of the notebooks in examples/ in their order, as a reader would.

They are stored with their outputs; nbconvert and ipykernel store them anew.

Usage: PYTHONPATH=src/otf_core .venv/bin/python bench/notebook.py
       PYTHONPATH=../src/otf_core python -m nbconvert --to notebook --execute --inplace NOTEBOOK
       (in examples/)
"""

import json
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def cells(notebook):
    """Code of a notebook, cell by cell."""
    data = json.loads(notebook.read_text(encoding='utf-8'))
    return [''.join(cell['source']) for cell in data['cells'] if cell['cell_type'] == 'code']


def main():
    for notebook in sorted((ROOT / 'examples').glob('*.ipynb')):
        names = {'__name__': '__main__'}
        for number, code in enumerate(cells(notebook), start=1):
            print(f'{notebook.name}, cell {number}')
            exec(compile(code, f'{notebook.name}, cell {number}', 'exec'), names)


if __name__ == '__main__':
    main()

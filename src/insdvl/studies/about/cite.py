"""The command `insdvl cite`: BibTeX of the software, and of the method that it is about."""

import argparse
from importlib.metadata import version

_SOFTWARE = """\
@software{{insdvl,
  title = {{insdvl: INS/DVL navigation with learned process noise}},
  author = {{{{ros_insdvl maintainers}}}},
  version = {{{version}}},
  license = {{Apache-2.0}}
}}
"""
#: Where learning the process noise from handcrafted features was published.
_PAPER = """\
@misc{or2022hybrid,
  title = {A Hybrid Adaptive Velocity Aided Navigation Filter with Application to {INS/DVL} Fusion},
  author = {Or, Barak and Klein, Itzik},
  year = {2022},
  eprint = {2211.01329},
  archiveprefix = {arXiv}
}
"""


def run(arguments: argparse.Namespace) -> int:
    """Print the entries."""
    print(_SOFTWARE.format(version=version("insdvl")))
    print(_PAPER, end="")
    return 0

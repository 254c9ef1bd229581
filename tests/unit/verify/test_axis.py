import numpy as np
import pytest
import robustlab as rl
import verify_cases as cases
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab.verify import Claim, Outcome, check

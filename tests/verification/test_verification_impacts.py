"""Impact tests of Chung & Ooi 2011."""

from conftest import verification

from warpcrete.verification import impacts

test_impacts = verification(impacts)

"""Single contacts against exact solutions."""

from conftest import verification

from warpcrete.verification import contacts

test_contacts = verification(contacts)

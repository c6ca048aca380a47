"""The contact laws, one a file; `contact.law.laws` finds them."""

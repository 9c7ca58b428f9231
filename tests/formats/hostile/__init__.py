"""Files that are made to break a reader: sound ones, attacks by hand, mutations, and what reads them."""

"""Files from outside: untrusted HDF5, MATLAB and text files into plain arrays, and atomic writing.

This room knows nothing of models; `robustlab.storage` maps trees to objects. In the order of reading::

    signature                           what a file is, whether it may be read, how large it may be
    isolation, reader_process           a child process opens it and sends what it holds
    hdf5_reader, matlab                 binary formats, brought to one form
    text_table, document                tables of numbers; JSON and TOML
    tree                                the form: groups, datasets, attributes; the header and hash of format 1
    hdf5, atomic                        the front of all trees, and writing them
    record_source                       what any of these holds of signals and clocks
    records, frames                     measured records, from any of these, and from tables of pandas
"""

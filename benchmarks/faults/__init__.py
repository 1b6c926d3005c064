"""What the dataflow does when processes, hosts, links, disks and clocks fail, on network namespaces for hosts."""

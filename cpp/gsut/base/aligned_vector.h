// A growable array on 64-byte boundaries (one cache line, one AVX-512 vector), a large one on huge
// pages: what is read and written all over it then needs no walk through the page table.
#pragma once

#include <cstddef>
#include <new>
#include <vector>

namespace gsut {

inline constexpr std::size_t kCacheLineBytes = 64;

// Arrays of this size (4 MiB) or more lie on huge pages, where the system has them (Linux).
inline constexpr std::size_t kHugePagesFrom = std::size_t{4} << 20;
inline constexpr std::size_t kHugePageBytes = std::size_t{2} << 20;

// Asks the system for huge pages behind [begin, begin + bytes), begin a multiple of their size.
void AdviseHugePages(void* begin, std::size_t bytes);

template <class T>
struct CacheLineAllocator {
  using value_type = T;
  CacheLineAllocator() = default;
  template <class U>
  CacheLineAllocator(const CacheLineAllocator<U>&) {}  // NOLINT: conversions are what allocators do
  T* allocate(std::size_t n) {
    void* const begin = ::operator new(n * sizeof(T), Alignment(n));
    if (n * sizeof(T) >= kHugePagesFrom) AdviseHugePages(begin, n * sizeof(T));
    return static_cast<T*>(begin);
  }
  void deallocate(T* p, std::size_t n) { ::operator delete(p, Alignment(n)); }
  static std::align_val_t Alignment(std::size_t n) {
    return std::align_val_t(n * sizeof(T) >= kHugePagesFrom ? kHugePageBytes : kCacheLineBytes);
  }
  // Leaves plain numbers uninitialised on resize: large buffers are filled by the kernels.
  template <class U>
  void construct(U* p) {
    ::new (static_cast<void*>(p)) U;
  }
  template <class U, class... Args>
  void construct(U* p, Args&&... args) {
    ::new (static_cast<void*>(p)) U(static_cast<Args&&>(args)...);
  }
  bool operator==(const CacheLineAllocator&) const { return true; }
};

template <class T>
using AlignedVector = std::vector<T, CacheLineAllocator<T>>;

}  // namespace gsut
